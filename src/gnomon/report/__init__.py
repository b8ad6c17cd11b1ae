"""Results -> one self-contained HTML file each.

page.py is the design, the same for every kind of result, and writes the file; static/ says what a calibration of one
sensor puts on it, camera_imu/ what a camera-IMU calibration does, cameras/ what one of cameras alone does.
"""
