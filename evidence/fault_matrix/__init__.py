"""The fault matrix: every fault in a seeded run, judged by bounds written before the run."""
