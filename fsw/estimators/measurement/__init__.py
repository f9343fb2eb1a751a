"""Measurement: the methods' predictions with their Jacobians, shared by all solvers."""
