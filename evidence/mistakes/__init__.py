"""Mistakes of configuration: each one alone, with the same simulated motion of a correct robot."""
