"""Truth -> Recording."""
