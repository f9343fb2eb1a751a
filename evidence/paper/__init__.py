"""A reproduction of the reference paper: its tables and figure, and those of the fused method."""
