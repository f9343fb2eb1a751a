"""A rough world, declared or undeclared; and an ideal world, for the cost of the declarations."""
