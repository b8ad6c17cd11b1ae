"""Samples -> static intervals and other marks; one file a detector."""
