"""Kill -9 at random instants of a real-time run: what must come back, and what must not be lost."""
