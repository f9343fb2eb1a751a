"""Evidence: the same motion with and without the target halves the error."""
