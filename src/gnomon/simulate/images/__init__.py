"""What simulated cameras record."""
