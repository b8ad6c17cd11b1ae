"""One file an estimation problem: data -> problem -> solution."""
