"""Data -> problem -> solution; one file an estimation problem."""
