"""Time on the wire, by bits counted by hand from ISO 11898-1:2015, and times of batches."""

import numpy as np
import pytest

from fsw.drivers.layout.signals import Message
from fsw.drivers.sources.validity import ByArrival, wire_s
from tests.support.driver_configs import bus_config

FAST = {"fd": True, "bitrate": 1_000_000, "data_bitrate": 5_000_000}
CLASSIC_BITS = 1 + 11 + 3 + 4 + 64 + 16 + 2 + 7 + 3  # identifier, control, CRC, ACK, EOF, pause
BASE_BITS = 1 + 11 + 5 + 1 + 2 + 7 + 3  # SOF to BRS; CRC delimiter, ACK, EOF, pause
FD_BITS = 1 + 4 + 96 + 4 + 17 + 6  # ESI, DLC, 12 bytes, stuff count, CRC, fixed stuff bits


@pytest.mark.parametrize(
    ("bus", "is_extended", "length", "expected_us"),
    [
        ({}, False, 8, CLASSIC_BITS),
        ({}, True, 8, CLASSIC_BITS + 20),
        ({"bitrate": 500_000}, False, 8, 2 * CLASSIC_BITS),
        (FAST, False, 12, BASE_BITS + FD_BITS / 5),
        (FAST, True, 12, BASE_BITS + 19 + FD_BITS / 5),
        (FAST, False, 20, BASE_BITS + (FD_BITS + 64 + 4 + 1) / 5),  # a CRC of 21 bits
    ],
)
def test_the_time_of_a_frame_on_the_wire(bus, is_extended, length, expected_us):
    message = Message(name="m", identifier=1, is_extended=is_extended, length=length, signals=())
    assert wire_s(message, bus_config(**bus)) == pytest.approx(1e-6 * expected_us)


PERIOD_NS, WIRE_NS = 10_000_000, 111_000


def arrivals(story: str, rng: np.random.Generator) -> np.ndarray:
    """Return the stamps of a drive whose timer is 80 ppm slow."""
    true_ns = 10**12 + 1.00008 * PERIOD_NS * np.arange(3000)
    late_ns = rng.exponential(20_000.0, len(true_ns))
    keep = np.ones(len(true_ns), np.bool_)
    if story == "lost":
        keep = rng.random(len(true_ns)) > 0.03
    if story == "late":
        late_ns += (
            rng.choice([0.0, 0.15, 0.4, 0.8], len(true_ns), p=[0.9, 0.04, 0.03, 0.03]) * PERIOD_NS
        )
    if story == "phase":
        late_ns[1500:] += 0.4 * PERIOD_NS
    if story == "early":
        late_ns[[700, 1400, 1401, 1402]] -= 0.3 * PERIOD_NS
    return np.sort(np.rint(true_ns + WIRE_NS + late_ns).astype(np.int64)[keep])


@pytest.mark.parametrize("story", ["even", "lost", "late", "phase", "early"])
@pytest.mark.parametrize("size", [1, 3, 16, 400])
def test_batches_of_arrivals_get_the_times_of_single_ones(story, size):
    t_ns = arrivals(story, np.random.default_rng(7))
    single, batched = (ByArrival(PERIOD_NS * 1e-9, 500.0, WIRE_NS) for _ in range(2))
    expected = [single.stamp(t, np.nan) for t in t_ns.tolist()]
    parts = [
        batched.stamps(own, np.full(len(own), np.nan))
        for own in np.split(t_ns, range(size, len(t_ns), size))
    ]
    number, times_ns = (np.concatenate(own) for own in zip(*parts, strict=True))
    assert list(zip(number.tolist(), times_ns.tolist(), strict=True)) == expected
