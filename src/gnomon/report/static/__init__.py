"""What a calibration of one sensor, or of an IMU by rests, puts on its report."""
