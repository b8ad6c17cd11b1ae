"""Logs of devices that say themselves what they measured: GoPro cameras and phones."""
