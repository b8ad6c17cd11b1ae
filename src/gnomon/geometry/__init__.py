"""Rotations and quaternion kinematics: pure functions on arrays."""
