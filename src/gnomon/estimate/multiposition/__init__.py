"""Static intervals and the rotations between them -> the IMU's errors (Tedaldi 2014)."""
