"""Estimators: one measurement model, recursive and batch solutions."""
