"""Known magnitudes -> the errors of one triad (Angrisano)."""
