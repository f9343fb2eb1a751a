"""Fixed-rate executive and alignment of samples into windows."""
