"""Errors of ports in the words of the system, which libraries repeat with number and place."""

import os


def of_system(error: BaseException) -> str:
    """Return the system's words for an error, without its number; else the error's own."""
    number = error.errno if isinstance(error, OSError) else None
    return str(error) if number is None else os.strerror(number)
