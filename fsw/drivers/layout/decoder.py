"""Compiled layouts: signals of many frames at once, as operations on arrays."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.layout.signals import MOST_BITS, Message, Signal, chain
from fsw.drivers.wire import MAX_DATA_BYTES

Octets = NDArray[np.uint8]  # (k, n): the data of k frames
Column = NDArray[Any]  # (k,)
_Read = Callable[[Octets], Column]
_LETTER = {"unsigned": "u", "signed": "i", "float": "f"}
_NATIVE_BITS = {"unsigned": (8, 16, 32, 64), "signed": (8, 16, 32, 64), "float": (16, 32, 64)}


class Decoder:
    """Values of some signals of one message; the same for every message of an equal layout.

    Signals that are whole numbers or floats at whole bytes are read by one view of the frames. Any
    other signal is shifted and masked out of the eight bytes around it.
    """

    def __init__(self, message: Message, signals: Sequence[Signal]) -> None:
        """Compile signals of a message without faults."""
        chains = [chain(message, signal) for signal in signals]
        own = dict.fromkeys([*signals, *(pair[0] for pairs in chains for pair in pairs)])
        native = [signal for signal in own if _is_native(signal)]
        others = [signal for signal in own if not _is_native(signal)]
        self._view, self._natives = _view_of(native), [f"f{k}" for k in range(len(native))]
        self._others = [_extraction(signal) for signal in others]
        place = {signal: k for k, signal in enumerate((*native, *others))}
        self._finish = [
            _finishing(signal, place[signal], [(place[own], pages) for own, pages in pairs])
            for signal, pairs in zip(signals, chains, strict=True)
        ]

    def __call__(self, data: Octets) -> list[Column]:
        """Return the signals' values; integers without scale stay integers.

        A value that is not in a frame, by its multiplexer or because it is the invalid one, is NaN.

        Parameters
        ----------
        data : (k, n), n at least as many bytes as the message has
        """
        raw: list[Column] = []
        if self._natives:
            rows = np.ascontiguousarray(data[:, : self._view.itemsize]).view(self._view)[:, 0]
            raw += [rows[name] for name in self._natives]
        if self._others:
            if data.shape[1] < MAX_DATA_BYTES:
                data = np.pad(data, ((0, 0), (0, MAX_DATA_BYTES - data.shape[1])))
            raw += [read(data) for read in self._others]
        return [finish(raw) for finish in self._finish]


def _finishing(
    signal: Signal, place: int, selectors: Sequence[tuple[int, frozenset[int]]]
) -> Callable[[list[Column]], Column]:
    """Return the function that makes values of the raw values of all compiled signals.

    `place`, and the first of each selector, are places in the list of raw values.
    """
    pages = [(at, list(values)) for at, values in selectors]
    is_plain = signal.scale == 1 and not signal.offset

    def numbers(own: Column) -> Column:
        if signal.number == "float" or (signal.bits == MOST_BITS and not is_plain):
            values = own.astype(np.float64)
        elif isinstance(signal.scale, float) or signal.bits == MOST_BITS:
            values = own
        else:
            values = own.astype(np.int64)
        if signal.scale != 1:
            values = values * signal.scale
        return values + signal.offset if signal.offset else values

    def finish(raw: list[Column]) -> Column:
        own = raw[place]
        if signal.number == "float":
            with np.errstate(invalid="ignore", over="ignore"):  # any bits may come from the wire
                values = numbers(own)
        else:
            values = numbers(own)
        absent = [~np.isin(raw[at], selected) for at, selected in pages]
        if signal.invalid is not None:
            absent.append(own == signal.invalid)
        return np.where(np.logical_or.reduce(absent), np.nan, values) if absent else values

    return finish


def _is_native(signal: Signal) -> bool:
    at_byte = signal.start % 8 == (7 if signal.big_endian else 0)
    if signal.big_endian and signal.bits == 8:
        return at_byte
    return at_byte and signal.bits in _NATIVE_BITS[signal.number]


def _view_of(signals: Sequence[Signal]) -> np.dtype[np.void]:
    """Return the structure of the first bytes of a frame that holds whole signals."""
    formats = [
        f"{'>' if own.big_endian else '<'}{_LETTER[own.number]}{own.bits // 8}" for own in signals
    ]
    offsets = [own.start // 8 for own in signals]
    ends = [at + own.bits // 8 for at, own in zip(offsets, signals, strict=True)]
    return np.dtype(
        {
            "names": [f"f{k}" for k in range(len(signals))],
            "formats": formats,
            "offsets": offsets,
            "itemsize": max(ends, default=1),
        }
    )


def _extraction(signal: Signal) -> _Read:
    """Return the function that reads the raw value of a signal from (k, 64) bytes."""
    places = signal.places()
    start, stop = min(places) // 8, max(places) // 8 + 1
    base = min(start, MAX_DATA_BYTES - 8)
    order = ">u8" if signal.big_endian else "<u8"
    last = 8 * (base + 8) - 1  # place of the last bit of the eight bytes
    behind = last - max(places) if signal.big_endian else signal.start - 8 * base
    mask = np.uint64((1 << signal.bits) - 1)

    def read(data: Octets) -> Column:
        eight = np.ascontiguousarray(data[:, base : base + 8]).view(order)[:, 0].astype(np.uint64)
        if stop <= base + 8:
            value = eight >> np.uint64(behind)
        else:  # more than 57 bits may touch a ninth byte
            ninth = data[:, base + 8].astype(np.uint64)
            value = _with_ninth(eight, ninth, behind, big_endian=signal.big_endian)
        return _typed(value & mask, signal)

    return read


def _with_ninth(eight: Column, ninth: Column, behind: int, *, big_endian: bool) -> Column:
    """Return a value that lies in eight bytes and a ninth one behind them."""
    if big_endian:  # `behind` is negative: so many bits of the ninth byte belong to the value
        return eight << np.uint64(-behind) | ninth >> np.uint64(8 + behind)
    return eight >> np.uint64(behind) | ninth << np.uint64(64 - behind)


def _typed(value: Column, signal: Signal) -> Column:
    """Return raw bits as the numbers that they are."""
    if signal.number == "float":
        width = signal.bits // 8
        return value.astype(f"u{width}").view(f"f{width}")
    if signal.number == "signed":
        spare = np.uint64(64 - signal.bits)
        return (value << spare).view(np.int64) >> np.int64(spare)
    return value if signal.bits == 64 else value.astype(np.int64)
