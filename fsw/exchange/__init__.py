"""Exchange: what processes hand to each other: ring, status, checkpoints, recordings."""
