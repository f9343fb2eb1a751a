"""Flights in which nothing is wrong, on seeds that nobody has used: which checks fire."""
