"""Signals and messages: which bits of a CAN frame hold which value.

Places of bits are counted as in a DBC file: bit 0 is the least significant one of byte 0. `start`
is the least significant bit of a little-endian signal and the most significant one of a big-endian
signal, which runs down its byte and continues at bit 7 of the next.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from fsw.drivers.wire import EFF_FLAG, EFF_MASK, MAX_DATA_BYTES, SFF_MASK

Number = Literal["unsigned", "signed", "float"]
FLOAT_BITS = (16, 32, 64)
MOST_BITS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """One value: `value = raw * scale + offset`."""

    name: str
    start: int
    bits: int
    big_endian: bool = False
    number: Number = "unsigned"
    scale: float = 1
    offset: float = 0
    unit: str = ""
    title: str = ""  # words of the file, where the name is the number of an object
    invalid: int | None = None  # raw value that stands for no value
    selector: str = ""  # signal whose value says whether this one is in the frame; empty: always
    pages: frozenset[int] = frozenset()  # raw values of the selector with which it is

    def places(self) -> list[int]:
        """Return its bits, most significant first, counted in the order in which bytes are sent.

        Bit 7 of byte 0 counts as 0, bit 0 of byte 0 as 7, bit 7 of byte 1 as 8.
        """
        if self.big_endian:
            first = _sent(self.start)
            return list(range(first, first + self.bits))
        return [_sent(bit) for bit in range(self.start + self.bits - 1, self.start - 1, -1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One kind of frame, known by its whole identifier of 11 or 29 bits.

    Frames are at least `length` bytes long; with `is_exact` they have this length.
    """

    name: str
    identifier: int
    is_extended: bool = False
    length: int
    is_exact: bool = False
    signals: tuple[Signal, ...]

    @property
    def word(self) -> int:
        """Identifier with its flag bit, as in an array of frames."""
        return self.identifier | EFF_FLAG * self.is_extended

    def named(self, *names: str) -> list[Signal]:
        """Return signals by their names."""
        by_name = {signal.name: signal for signal in self.signals}
        return [by_name[name] for name in names]

    def signal(self, name: str) -> Signal | None:
        """Return a signal by its name; None if the message has no such signal."""
        return next((signal for signal in self.signals if signal.name == name), None)


def _sent(bit: int) -> int:
    return bit // 8 * 8 + 7 - bit % 8


def faults(message: Message) -> Iterator[str]:
    """Yield a line for each fault of a message: what is wrong, and the bound."""
    top = EFF_MASK if message.is_extended else SFF_MASK
    if not 0 <= message.identifier <= top:
        yield f"{message.name}: identifier 0x{message.identifier:x}; must be at most 0x{top:x}"
    if not 0 <= message.length <= MAX_DATA_BYTES:
        yield f"{message.name}: {message.length} bytes; must be at most {MAX_DATA_BYTES}"
        return
    names = {signal.name: signal for signal in message.signals}
    for signal in message.signals:
        if fault := _fault(signal, message.length, names):
            yield f"{message.name}.{signal.name}: {fault}"
            return
    yield from _overlaps(message)


def _fault(signal: Signal, length: int, names: dict[str, Signal]) -> str:
    if not 1 <= signal.bits <= MOST_BITS:
        return f"{signal.bits} bits; must be 1 to {MOST_BITS}"
    if signal.number == "float" and signal.bits not in FLOAT_BITS:
        return f"a float of {signal.bits} bits; must be of 16, 32 or 64"
    if signal.start < 0 or max(signal.places()) >= 8 * length:
        return f"{signal.bits} bits from {signal.start} on leave the frame of {length} bytes"
    if not (isfinite(signal.scale) and isfinite(signal.offset) and signal.scale):
        return f"scale {signal.scale:g}, offset {signal.offset:g}; must be finite and not 0"
    return _fault_of_selectors(signal, names)


def _fault_of_selectors(signal: Signal, names: dict[str, Signal]) -> str:
    seen, at = {signal.name}, signal.selector
    while at:
        if at not in names:
            return f"its multiplexer {at} is not a signal of the message"
        if at in seen:
            return f"its multiplexer {at} depends on itself"
        seen.add(at)
        at = names[at].selector
    return ""


def _overlaps(message: Message) -> Iterator[str]:
    """Yield the first two signals that share a bit and can be in one frame."""
    owners: dict[int, list[Signal]] = {}
    for signal in message.signals:
        for place in signal.places():
            for other in owners.setdefault(place, []):
                if not _exclude(signal, other):
                    yield f"{message.name}.{signal.name}: overlaps {other.name}"
                    return
            owners[place].append(signal)


def _exclude(one: Signal, other: Signal) -> bool:
    return bool(one.selector) and one.selector == other.selector and not one.pages & other.pages


def chain(message: Message, signal: Signal) -> Sequence[tuple[Signal, frozenset[int]]]:
    """Return the multiplexers of a signal with the values that select it, nearest first."""
    found: list[tuple[Signal, frozenset[int]]] = []
    while signal.selector:
        selector = message.signal(signal.selector)
        if selector is None:
            break
        found.append((selector, signal.pages))
        signal = selector
    return found
