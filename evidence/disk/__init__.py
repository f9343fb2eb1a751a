"""Campaign on bad disks: the service on small disks that fill, fail, vanish or are slow."""
