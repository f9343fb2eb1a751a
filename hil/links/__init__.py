"""Links: the ends of the daemon's ports in virtual time, and their clock."""
