"""A known rate about an unknown axis -> the errors of a gyroscope (Angrisano)."""
