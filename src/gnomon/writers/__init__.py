"""Calibration -> files of this and other projects."""
