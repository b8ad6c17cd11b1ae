"""The path of a calibrated rig from one camera and one IMU, with the calibration frozen."""
