"""What a calibration of cameras alone puts on its report."""
