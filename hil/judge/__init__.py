"""Judge: score, bounds and report of a run."""
