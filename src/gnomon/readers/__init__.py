"""Bytes -> Recording or Calibration; one file a format."""
