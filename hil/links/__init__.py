"""Links: the far ends of the daemon's ports, in virtual time."""
