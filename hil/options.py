"""Kinds of command-line options."""

from __future__ import annotations

import argparse


def count(text: str) -> int:
    """Return a count; argparse names the option of an invalid one."""
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 1")
    return number
