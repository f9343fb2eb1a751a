"""Recursive: the online estimator, block by block."""
