"""Recordings with faults, wild ones and healthy ones, and what gnomon is asked of them: what only tests need."""
