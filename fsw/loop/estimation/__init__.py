"""Estimation: from batches of traffic to published estimates, in a process of its own."""
