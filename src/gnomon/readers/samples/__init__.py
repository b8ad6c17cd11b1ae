"""Samples of one IMU: tables, arrays and pose tables; what their columns are, and reading block by block."""
