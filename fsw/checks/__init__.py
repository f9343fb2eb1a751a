"""Checks that find faults of a configuration before a device is opened."""
