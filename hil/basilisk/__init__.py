"""The second truth: the engine Basilisk simulates the scenarios of the bench."""
