"""Identification from tables that a laboratory would record: motion, static poses, a wrist."""
