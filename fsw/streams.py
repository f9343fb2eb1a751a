"""The standard streams of a command."""

import os

LAST_STREAM = 2  # standard error


def open_standard_streams() -> None:
    """Open the streams that were closed: no other file may get their numbers."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= LAST_STREAM:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
