"""Samples -> static and steady intervals, saturation, noise, the time base."""
