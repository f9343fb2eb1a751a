"""Evidence: the commands that produce the published figures."""
