from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.config import Mounting
from fsw.drivers.sources.star_tracker import StarTrackerSource, to_bus
from fsw.drivers.wire import ByteChunk
from fsw.messages.findings import Fault
from tests.support.driver_configs import star_tracker_config
from tests.support.encoders import solution
from tests.support.samples import Row, rows

MS = 1_000_000
T0 = 10**12
BYTE_NS = 10e9 / 115200
Q = (0.5, -0.5, 0.5, 0.5)


class RowSource(StarTrackerSource):
    """A star tracker whose samples come row by row."""

    def feed(self, chunks: Sequence[ByteChunk]) -> list[Row]:  # type: ignore[override]
        return rows(super().feed(chunks))


def matrix(q: tuple[float, ...]) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def frame(k: int, q: tuple[float, ...] = Q, **changes: int) -> bytes:
    return solution(q, ticks=100 + k, **({"unix_us": 10**15 + 100_000 * k} | changes))


def run(unit: RowSource, ks: range) -> list[Row]:
    return unit.feed([ByteChunk(T0 + 100 * MS * k, frame(k)) for k in ks])


units = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 0.01)


@given(units, units, st.sampled_from(["inertial_to_tracker", "tracker_to_inertial"]))
def test_quaternion_is_turned_to_the_bus(
    a: tuple[float, ...], b: tuple[float, ...], rotation: str
) -> None:
    q_wxyz = tuple(np.array(a) / np.linalg.norm(a))
    q_BS = tuple(np.array(b) / np.linalg.norm(b))
    R_unit = matrix((*q_wxyz[1:], q_wxyz[0]))
    R_NS = R_unit.T if rotation == "inertial_to_tracker" else R_unit
    q_NB = to_bus(q_wxyz, q_BS, rotation)  # type: ignore[arg-type]
    np.testing.assert_allclose(matrix(q_NB), R_NS @ matrix(q_BS).T, atol=1e-12)


def test_by_arrival_the_latency_to_the_last_byte_is_removed() -> None:
    (sample,) = run(RowSource(star_tracker_config()), range(1))
    escaped = len(frame(0)) - 89
    assert sample.t_ns == T0 - round(100e6 + escaped * BYTE_NS)
    assert sample.t_receive_ns == T0


def test_by_unit_time_late_arrivals_do_not_matter() -> None:
    unit = RowSource(star_tracker_config(time="unit"))
    rng = np.random.default_rng(3)
    samples = []
    for k in range(300):
        wire_ns = round(len(frame(k)) * BYTE_NS)
        late_ns = int(rng.exponential(3 * MS))
        samples += unit.feed([ByteChunk(T0 + 100 * MS * k + wire_ns + late_ns, frame(k))])
    error = np.array([s.t_ns - (T0 + 100 * MS * k - 100 * MS) for k, s in enumerate(samples)])
    assert np.sqrt(np.mean(error[200:] ** 2.0)) < 300_000  # arrivals alone: 4.2 ms rms


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (frame(20), "sequence"),
        (frame(12), "sequence"),
        (frame(21, unix_us=3 * 10**18), "sequence"),
        (frame(21, unix_us=10**15 + 100_000 * 20 + 100), "sequence"),
        (frame(21, unix_us=10**15 + 100_000 * 20 + 300_000), "sequence"),
        (frame(21, q=(2.0, 0.0, 0.0, 0.0)), "range"),
        (frame(21, valid=0), "status"),
        (frame(21, address=0x33), "node"),
        (b"\xc0" + frame(21)[7:], "crc"),
    ],
)
@pytest.mark.parametrize("time", ["unit", "arrival"])
def test_a_bad_frame_changes_nothing_but_a_counter(bad: bytes, reason: str, time: str) -> None:
    clean = RowSource(star_tracker_config(time=time))
    dirty = RowSource(star_tracker_config(time=time))
    reference = run(clean, range(60))
    samples = run(dirty, range(21))
    samples += dirty.feed([ByteChunk(T0 + 2050 * MS, bad)])
    samples += run(dirty, range(21, 60))
    assert samples == reference
    assert dirty.counters[f"reject_{reason}"] == dirty.counters["rejected"] == 1
    assert dirty.counters["lost"] == 0


def test_the_second_solution_is_judged_like_any_other() -> None:
    unit = RowSource(star_tracker_config())
    run(unit, range(1))
    assert unit.feed([ByteChunk(T0 + 100 * MS, frame(1, unix_us=10**15 + 400_000))]) == []
    assert unit.counters["reject_sequence"] == 1
    assert len(run(unit, range(2, 10))) == 8


def test_lost_solutions_are_counted_and_a_new_unit_time_is_believed() -> None:
    unit = RowSource(star_tracker_config())
    run(unit, range(10))
    run(unit, range(13, 20))
    assert unit.counters["lost"] == 3
    later = [
        ByteChunk(T0 + 100 * MS * k, frame(k, unix_us=50 + 100_000 * k)) for k in range(20, 30)
    ]
    assert len(unit.feed(later)) == 8


@pytest.mark.parametrize("time", ["unit", "arrival"])
@pytest.mark.parametrize("together", [True, False])
def test_what_this_computer_read_late_is_no_fault_of_the_unit(together: bool, time: str) -> None:
    """Ten solutions wait up to 0.9 s for a computer that was busy: they come in one chunk."""
    unit = RowSource(star_tracker_config(time=time))
    run(unit, range(60))
    read_ns, waiting = T0 + 100 * MS * 69, [frame(k) for k in range(60, 70)]
    if not together:  # the same bytes at nearly the same time, but read as they came
        unit.feed([ByteChunk(read_ns + k, data) for k, data in enumerate(waiting)])
        assert Fault.TRACKER_CLOCK in [finding.fault for finding in unit.findings()]
        return
    samples = unit.feed([ByteChunk(read_ns, b"".join(waiting))])
    assert unit.findings() == []
    if time == "arrival":  # when they were valid is not known
        assert samples == []
        assert unit.counters["reject_stale"] == 10
    else:
        error_s = [1e-9 * (s.t_ns - T0) - 0.1 * (k - 1) for k, s in enumerate(samples, start=60)]
        assert len(samples) == 10
        assert np.abs(error_s).max() < 0.012  # the time on the wire and of an escape
    assert len(run(unit, range(70, 80))) == 10
    assert unit.findings() == []
    assert unit.counters["lost"] == 0


@given(st.lists(st.binary(max_size=200), max_size=6))
def test_arbitrary_bytes_never_raise_and_are_conserved(parts: list[bytes]) -> None:
    mounted = Mounting(p_BS_m=(0, 0, 0), q_BS_xyzw=(0.6, 0.0, 0.0, 0.8))
    unit = RowSource(star_tracker_config(mounting=mounted))
    for at, part in enumerate([*parts, frame(1), *parts]):
        unit.feed([ByteChunk(T0 + at, part)])
    c = unit.counters
    total = c["accepted_bytes"] + c["rejected_bytes"] + c["skipped_bytes"] + c["pending_bytes"]
    assert total == c["received_bytes"]
