"""Estimation: from batches of traffic to published estimates, in a separate process."""
