"""Sensors that lie slowly, and whether an estimate loses its validity before it is wrong."""
