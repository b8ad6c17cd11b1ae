"""Camera-IMU calibration by continuous-time batch estimation (Krebs).

board_poses -> alignment -> knots -> trajectory -> (inertial_terms, visual_terms -> normal equations) -> batch
"""
