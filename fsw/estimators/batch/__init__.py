"""Batch: the same problem solved over stored blocks."""
