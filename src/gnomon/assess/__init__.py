"""Residuals, hold-out, observability, verdict and advice."""
