"""Checks: everything that can be wrong with a configuration, found before a device is opened."""
