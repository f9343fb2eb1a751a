"""Datagrams of a feed: the vectors of docs/howto/feed.md, and whatever else may arrive."""

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.drivers.codecs.feed import Datagram, Kind, decode_datagram
from fsw.drivers.wire import Reject
from hil.devices.feed import as_json, packed, sealed

# docs/howto/feed.md: source 7, sequence 258, two joints, the second torque is not valid
VECTOR = bytes.fromhex(
    "46535731"
    "07000000" "02010000"
    "01" "00" "0400"
    "0700000000000000"
    "00ca9a3b00000000" "e0929b3b00000000"
    "000000000000e03f" "000000000000f4bf" "0000000000002840" "0000000000000000"
)  # fmt: skip
KEY = bytes(range(32))
VALUES = (0.5, -1.25, 12.0, math.nan)


def same(found: Datagram | Reject, other: Datagram) -> bool:
    return repr(found) == repr(other)  # NaN is not equal to itself


def test_the_packed_vector_of_the_document_is_decoded():
    expected = Datagram(7, 258, Kind.JOINTS, "monotonic", 1_000_000_000, 1_000_051_424, VALUES)
    assert same(decode_datagram(VECTOR), expected)


def test_the_simulated_sender_makes_the_same_bytes_and_the_same_as_json():
    times_ns = 1_000_000_000, 1_000_051_424
    values = [0.5, -1.25, 12.0, 0.0]
    assert packed(7, 258, times_ns, values, mask=7) == VECTOR
    text = as_json(7, 258, times_ns, [0.5, -1.25, 12.0, None])
    assert same(decode_datagram(text), decode_datagram(VECTOR))
    masked = json.dumps(json.loads(as_json(7, 258, times_ns, values)) | {"mask": 7}).encode()
    assert same(decode_datagram(masked), decode_datagram(VECTOR))


@pytest.mark.parametrize("clock", ["monotonic", "unix", "tai", "device"])
@pytest.mark.parametrize("kind", ["joints", "imu", "attitude"])
def test_every_kind_and_clock_has_one_number(kind, clock):
    item = decode_datagram(packed(1, 2, (3, 4), [0.0], kind=kind, clock=clock))
    assert (item.kind.name.lower(), item.clock) == (kind, clock)


def test_a_value_that_is_not_finite_is_not_valid():
    item = decode_datagram(packed(1, 2, (3, 4), [math.inf, 2.0, -math.inf, math.nan]))
    assert [math.isnan(value) for value in item.values] == [True, False, True, True]


def test_a_keyed_datagram_is_refused_when_any_bit_of_it_changes():
    for body in (VECTOR, as_json(7, 258, (1, 2), [0.5])):
        whole = sealed(body, KEY)
        assert isinstance(decode_datagram(whole, KEY), Datagram)
        for place in range(8 * len(whole)):
            flipped = bytearray(whole)
            flipped[place // 8] ^= 1 << place % 8
            assert decode_datagram(bytes(flipped), KEY) is Reject.CRC
    assert decode_datagram(VECTOR, KEY) is Reject.CRC
    assert decode_datagram(sealed(VECTOR, KEY[::-1]), KEY) is Reject.CRC
    assert decode_datagram(sealed(VECTOR, KEY)) is Reject.LENGTH


def test_a_datagram_of_any_other_length_is_refused():
    for length in range(len(VECTOR)):
        assert isinstance(decode_datagram(VECTOR[:length]), Reject)
    assert decode_datagram(VECTOR + b"\0") is Reject.LENGTH
    assert decode_datagram(b"{" + b" " * 1400) is Reject.LENGTH
    assert decode_datagram(b"FSW2" + VECTOR[4:]) is Reject.SYNC


GOOD = {
    "source": 7, "sequence": 1, "kind": "joints", "clock": "unix", "t_valid_ns": 1,
    "t_sent_ns": 2, "values": [0.5],
}  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {"source": 1 << 32},
        {"source": -1},
        {"sequence": 1.0},
        {"sequence": "1"},
        {"kind": "wheel"},
        {"kind": 1},
        {"clock": "gps"},
        {"t_valid_ns": 1 << 63},
        {"t_sent_ns": -1},
        {"values": ["0.5"]},
        {"values": 0.5},
        {"values": [10**400]},
        {"values": [[0.5]]},
        {"values": [0.0] * 65},
        {"mask": 0.5},
        {"values": None},
    ],
)
def test_json_of_a_wrong_content_is_refused(changes):
    assert isinstance(decode_datagram(json.dumps(GOOD).encode()), Datagram)
    assert decode_datagram(json.dumps(GOOD | changes).encode()) is Reject.LENGTH


@pytest.mark.parametrize(
    "text",
    [
        b"{",
        b"{}",
        b'{"a":' * 250,
        b'{"values":[' + b"[" * 1000,
        b"{\xff}",
        b'{"source":' + b"9" * 1300,
    ],
)
def test_hostile_json_is_refused(text):
    assert decode_datagram(text) is Reject.LENGTH


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_refused_or_decoded_to_finite_values(data, is_headed):
    item = decode_datagram(VECTOR[:16] + data if is_headed else data)
    if isinstance(item, Datagram):
        assert all(math.isfinite(value) or math.isnan(value) for value in item.values)
