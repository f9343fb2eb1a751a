"""The reference study again: its tables and figure, beside what the fused estimator adds."""
