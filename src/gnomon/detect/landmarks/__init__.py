"""Landmarks of a scene, in images."""
