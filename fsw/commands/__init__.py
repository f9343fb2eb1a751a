"""Commands: the bodies of the `fsw` commands."""
