"""Faults: errors put into links and devices."""
