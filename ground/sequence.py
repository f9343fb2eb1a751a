"""Request sequences as text: one telecommand a line, and `wait SECONDS` between them."""

import math
import shlex
import struct
from collections.abc import Callable

from ground.commands import Catalogue, given_arguments
from ground.errors import UsageError

WAIT = "wait"
MAX_WAIT_S = 86_400.0
MAX_BYTES = 16384
DIRECT_BYTES = 900  # most bytes of entries in one telecommand; more are uploaded as a file


def compile_sequence(text: str, catalogue: Catalogue, next_sequence: Callable[[], int]) -> bytes:
    """Return the entries of a sequence: each a telecommand packet, and the delay after it [ms].

    Empty lines and text after a `#` are ignored.

    Parameters
    ----------
    next_sequence : returns the sequence count of the next telecommand

    Raises
    ------
    UsageError that names the faulty line.
    """
    entries: list[tuple[bytes, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            words = shlex.split(line, comments=True)
            if not words:
                continue
            if words[0].lower() == WAIT:
                _add_wait(entries, words[1:])
            else:
                given = given_arguments(words[1:])
                entries.append((catalogue.build(words[0], given, next_sequence()), 0.0))
        except (UsageError, ValueError) as error:
            raise UsageError(f"line {number}: {error}") from error
    if not entries:
        raise UsageError("no telecommand in it")
    data = b"".join(packet + struct.pack(">I", round(1e3 * wait_s)) for packet, wait_s in entries)
    if len(data) > MAX_BYTES:
        raise UsageError(f"{len(data)} bytes; must be at most {MAX_BYTES}")
    return data


def _add_wait(entries: list[tuple[bytes, float]], words: list[str]) -> None:
    """Add a wait to the delay after the last telecommand."""
    if len(words) != 1 or not entries:
        raise UsageError("wait SECONDS, after a telecommand")
    packet, wait_s = entries[-1]
    wait_s += float(words[0])
    if not math.isfinite(wait_s) or not 0.0 <= wait_s <= MAX_WAIT_S:
        raise UsageError(f"wait {words[0]}: must be 0 to {MAX_WAIT_S:g} s after one telecommand")
    entries[-1] = packet, wait_s
