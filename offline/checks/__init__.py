"""Checks of recorded data against a configuration: what is wrong with either, and why."""
