"""Least squares and covariance; knows no sensor."""
