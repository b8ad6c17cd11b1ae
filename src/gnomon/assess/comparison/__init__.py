"""Calibrations side by side."""
