"""Checks for all targets, and streams with correct check values made from inputs.

An input is read as segments `op | length | payload`. Random bytes hardly ever have a correct CRC.
So a segment may be sealed: an encoder that is independent of the flight software adds the check
value. Other segments are used unchanged.
"""

from collections.abc import Callable, Iterator

SEALED = 0x01
ENDS_CHUNK = 0x02
MAX_INPUT_BYTES = 4096
Target = Callable[[bytes], None]
Seal = Callable[[bytes], bytes]


class OracleError(AssertionError):
    """A requirement on a parser is violated."""


def require(condition: object, what: str, *details: object) -> None:
    """Raise OracleError unless the condition holds."""
    if not condition:
        raise OracleError(f"{what}: {details}")


def segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield op and payload of every segment; the last payload may be shorter than its length."""
    at = 0
    while at + 2 <= len(data):
        op, length = data[at], data[at + 1]
        yield op, data[at + 2 : at + 2 + length]
        at += 2 + length


def chunks(data: bytes, seal: Seal) -> list[bytes]:
    """Return the stream of an input, divided into pieces at the segments with ENDS_CHUNK."""
    out, piece = [], b""
    for op, payload in segments(data):
        piece += seal(payload) if op & SEALED else payload
        if op & ENDS_CHUNK:
            out.append(piece)
            piece = b""
    return [*out, piece]
