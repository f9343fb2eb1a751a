"""The second truth: Basilisk flies the scenarios of the bench."""
