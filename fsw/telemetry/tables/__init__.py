"""Tables: content, effect and storage of the uplinked tables."""
