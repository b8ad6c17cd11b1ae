"""What was learned: calibrations with their covariance, and what was seen on the way (diagnostics)."""
