"""A world that is not ideal, with and without what says so; and an ideal one, for the cost."""
