"""Link: bytes and packets between the daemon and the ground."""
