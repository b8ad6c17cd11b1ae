"""Known magnitudes -> the errors of one triad (document C)."""
