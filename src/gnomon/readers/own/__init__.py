"""Gnomon's own files: calibrations, noise, options, what a use needs."""
