"""The first guess of the batch estimation."""
