"""Implementations of the `fsw` commands."""
