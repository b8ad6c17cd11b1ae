"""Rotations, quaternion kinematics: pure functions on arrays."""
