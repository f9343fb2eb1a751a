"""Excitation: joint trajectories that make the fused estimate good, within every limit."""
