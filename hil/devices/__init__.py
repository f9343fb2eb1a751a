"""Simulated devices with encoders of their own."""
