"""Compiled layouts against cantools, which reads frames one by one and another way."""

import itertools
import math

import numpy as np
import pytest
from cantools.database.can import Message as LibraryMessage
from cantools.database.can import Signal as LibrarySignal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.signals import Message, Signal, faults

LENGTHS = (1, 2, 5, 8, 12, 20, 64)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Return a message of signals at any place that share no bit, some of them multiplexed."""
    length = draw(st.sampled_from(LENGTHS))
    free, signals = set(range(8 * length)), []
    for k in range(draw(st.integers(1, 8))):
        number = draw(st.sampled_from(["unsigned", "signed", "float"]))
        bits = draw(st.sampled_from([16, 32, 64]) if number == "float" else st.integers(1, 64))
        own = Signal(
            name=f"s{k}",
            start=draw(st.integers(0, 8 * length - 1)),
            bits=bits,
            big_endian=draw(st.booleans()),
            number=number,
            scale=draw(st.sampled_from([1, 0.01, -3, 1e-7, math.tau / 2**24])),
            offset=draw(st.sampled_from([0, -40, 12.5])),
        )
        if max(own.places()) < 8 * length and free.issuperset(own.places()):
            free -= set(own.places())
            signals.append(own)
    return Message(name="m", identifier=1, length=length, signals=tuple(signals))


def library(message: Message) -> LibraryMessage:
    return LibraryMessage(
        frame_id=message.identifier,
        name=message.name,
        length=message.length,
        signals=[
            LibrarySignal(
                name=own.name,
                start=own.start,
                length=own.bits,
                byte_order="big_endian" if own.big_endian else "little_endian",
                is_signed=own.number == "signed",
                conversion=BaseConversion.factory(
                    own.scale, own.offset, is_float=own.number == "float"
                ),
                is_multiplexer=any(other.selector == own.name for other in message.signals),
                multiplexer_ids=sorted(own.pages) or None,
                multiplexer_signal=own.selector or None,
            )
            for own in message.signals
        ],
    )


def test_every_signal_equals_the_librarys() -> None:
    seen = itertools.count()

    @settings(max_examples=150, deadline=None)
    @given(messages(), st.integers(0, 2**32 - 1))
    def compare(message: Message, seed: int) -> None:
        assert not list(faults(message))
        data = np.random.default_rng(seed).integers(0, 256, (20, message.length), np.uint8)
        names = [own.name for own in message.signals]
        columns = Decoder(message, message.signals)(data)
        oracle = library(message)
        for row, octets in enumerate(data):
            expected = oracle.decode(octets.tobytes())
            for name, column in zip(names, columns, strict=True):
                next(seen)
                found, value = float(column[row]), float(expected[name])
                assert found == value or (math.isnan(found) and math.isnan(value))

    compare()
    assert next(seen) > 2000


PAGED = Message(
    name="paged",
    identifier=1,
    length=8,
    signals=(
        Signal(name="mode", start=0, bits=4),
        Signal(name="part", start=4, bits=4, selector="mode", pages=frozenset({1, 3})),
        Signal(name="a", start=8, bits=16, selector="mode", pages=frozenset({0})),
        Signal(name="b", start=8, bits=12, number="signed", selector="part", pages=frozenset({2})),
        Signal(name="always", start=32, bits=8),
    ),
)


def test_a_signal_of_another_page_is_absent() -> None:
    assert not list(faults(Message(**{**_fields(PAGED), "signals": PAGED.signals[:3]})))
    names = [own.name for own in PAGED.signals]
    data = np.array([[k, 7, 9, 0, 5, 0, 0, 0] for k in range(256)], np.uint8)
    found = dict(zip(names, Decoder(PAGED, PAGED.signals)(data), strict=True))
    for k in range(256):
        mode, part = k & 15, k >> 4
        has = {"part": mode in (1, 3), "a": mode == 0, "b": mode in (1, 3) and part == 2}
        for name, is_there in has.items():
            assert math.isnan(found[name][k]) != is_there, (k, name)
    assert found["a"][0] == 0x0907
    assert found["b"][0x21] == 0x907 - 0x1000
    assert (found["always"] == 5).all()


def test_an_invalid_raw_value_is_no_value() -> None:
    own = Signal(name="v", start=15, bits=16, big_endian=True, scale=0.5, invalid=0x7FFF)
    message = Message(name="m", identifier=1, length=3, signals=(own,))
    data = np.array([[9, 0x7F, 0xFF], [9, 0x7F, 0xFE]], np.uint8)
    (found,) = Decoder(message, [own])(data)
    assert math.isnan(found[0])
    assert found[1] == 0x7FFE / 2


def _fields(message: Message) -> dict[str, object]:
    return {"name": message.name, "identifier": message.identifier, "length": message.length}


def one(**changes: object) -> Signal:
    return Signal(**({"name": "s", "start": 0, "bits": 8} | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        ((one(bits=0),), "m.s: 0 bits; must be 1 to 64"),
        ((one(bits=65),), "m.s: 65 bits; must be 1 to 64"),
        ((one(bits=24, number="float"),), "m.s: a float of 24 bits; must be of 16, 32 or 64"),
        ((one(start=60),), "m.s: 8 bits from 60 on leave the frame of 8 bytes"),
        ((one(start=60, bits=8, big_endian=True),), "m.s: 8 bits from 60 on leave the frame"),
        ((one(start=-1),), "m.s: 8 bits from -1 on leave"),
        ((one(scale=math.inf),), "m.s: scale inf, offset 0; must be finite and not 0"),
        ((one(scale=0),), "m.s: scale 0, offset 0; must be finite and not 0"),
        ((one(selector="x"),), "m.s: its multiplexer x is not a signal of the message"),
        ((one(selector="s"),), "m.s: its multiplexer s depends on itself"),
        ((one(), one(name="t", start=7, bits=2)), "m.t: overlaps s"),
    ],
)
def test_faults_are_one_line(signals: tuple[Signal, ...], words: str) -> None:
    (line,) = faults(Message(name="m", identifier=1, length=8, signals=signals))
    assert line.startswith(words)


def test_an_identifier_or_a_length_beyond_the_bound_is_a_fault() -> None:
    (line,) = faults(Message(name="m", identifier=0x800, length=8, signals=()))
    assert line == "m: identifier 0x800; must be at most 0x7ff"
    assert not list(
        faults(Message(name="m", identifier=0x800, is_extended=True, length=8, signals=()))
    )
    (line,) = faults(Message(name="m", identifier=1, length=65, signals=()))
    assert line == "m: 65 bytes; must be at most 64"
