"""Bytes -> Recording; one file a format."""
