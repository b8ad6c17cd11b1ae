"""Recordings, boards, tables and results -> files."""
