"""Calibration files of other projects."""
