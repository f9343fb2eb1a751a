"""`fsw init`: write a configuration for a URDF, from flags, answers, recordings or logs."""
