"""Many file transfers, some interrupted: each must end with the right file or with a reason."""
