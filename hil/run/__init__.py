"""Run: one run of the bench, in virtual or real time."""
