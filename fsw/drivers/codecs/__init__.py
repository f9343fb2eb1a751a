"""Pure codecs: wire bytes to samples or counted rejects."""
