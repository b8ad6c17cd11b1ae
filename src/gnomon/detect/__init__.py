"""Samples -> static intervals and other marks."""
