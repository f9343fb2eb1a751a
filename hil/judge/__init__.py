"""Judge: score, Cramer-Rao bound and report of a run."""
