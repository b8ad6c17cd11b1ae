"""What follows from the estimate: covariance, consistency, and what is published."""
