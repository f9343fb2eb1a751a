"""Mistakes of configuration: each alone, on the same motion, against a robot that is as it is."""
