"""Evidence for the excitation planner: every figure from one command."""
