"""Calibration and diagnostics -> one self-contained HTML file."""
