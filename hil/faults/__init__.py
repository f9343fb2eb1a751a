"""Faults: errors that are inserted in links and devices."""
