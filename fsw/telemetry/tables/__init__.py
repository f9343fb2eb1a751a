"""Tables that the ground uploads: their content, their effect and their storage."""
