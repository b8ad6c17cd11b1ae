"""What a camera-IMU calibration puts on its report."""
