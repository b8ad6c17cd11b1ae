"""Kalibr's files."""
