"""Calibration on simulated recordings: every figure against the error that the truth has."""
