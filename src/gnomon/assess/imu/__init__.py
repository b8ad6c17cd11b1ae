"""Verdict, tables and findings of IMUs alone, by rests and rotations, by magnitudes, and of their noise."""
