"""Drivers: ports (I/O shells), codecs (pure bytes to samples) and the sources that join them."""
