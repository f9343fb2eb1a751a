"""Pure codecs: they convert wire bytes to values, or to a reason for rejection."""
