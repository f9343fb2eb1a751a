"""Evidence for the excitation planner: one command produces every figure."""
