"""Batch identification methods on sample sets; need numba, so never part of the loop process."""
