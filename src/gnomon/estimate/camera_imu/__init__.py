"""Camera-IMU calibration by continuous-time batch estimation (Krebs).

board_poses -> alignment -> first_guess -> (inertial_terms, visual_terms -> normal equations) -> batch -> solution
"""
