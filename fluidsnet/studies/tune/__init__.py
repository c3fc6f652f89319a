"""Fit the numbers of a prior to data."""
