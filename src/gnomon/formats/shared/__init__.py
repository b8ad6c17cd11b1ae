"""What the formats of several projects have in common."""
