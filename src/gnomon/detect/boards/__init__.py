"""Image -> which corner of which calibration board is where."""
