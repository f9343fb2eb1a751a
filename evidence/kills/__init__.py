"""Kill -9 at random times of a real-time run: processes must return, and data must not be lost."""
