"""Effects: each file declares its states, its configuration keys and what it adds to a channel."""
