"""Calibration files of gnomon and of other projects, both ways: one file a format."""
