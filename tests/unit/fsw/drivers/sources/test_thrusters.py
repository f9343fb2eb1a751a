"""Reports of a valve driver to states and changes, and what lost ones cost."""

import struct

import numpy as np
import pytest

from fsw.config.thrusters import ThrusterConfig
from fsw.drivers.sources.thrusters import ThrusterBusSource
from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages.findings import Fault
from tests.support.driver_configs import bus_config
from tests.support.thruster_cases import thruster_settings

MS = 1_000_000
T0 = 10**12


def source() -> ThrusterBusSource:
    thrusters = [ThrusterConfig.model_validate(thruster_settings(k)) for k in range(2)]
    return ThrusterBusSource(bus_config(latch_offset_s=1e-5), list(enumerate(thrusters)), {})


def sync(k: int) -> CanFrame:
    return CanFrame(T0 + 2 * MS * k, 0x080, bytes([k % 240 + 1]))


def report(k: int, valves: int, age: int, changes: int, status: int = 8) -> CanFrame:
    data = struct.pack("<HHBBBB", valves, age, changes, 0, status, k % 240 + 1)
    return CanFrame(T0 + 2 * MS * k + 300_000, 0x1B1, data)


def states(bus: ThrusterBusSource, *frames: CanFrame) -> list[tuple[int, int, float, float]]:
    """Time from T0 [us], thruster, state, whether it is a change."""
    s = bus.feed(frame_array(list(frames)))
    rows = zip(s.t_ns - T0, s.device, *s.values.T, strict=True)
    return [(int(t) // 1000, int(k), float(on), float(new)) for t, k, on, new in rows]


def test_a_change_has_its_own_time_and_valves_are_told_apart() -> None:
    bus = source()
    assert states(bus, sync(0), report(0, 1, 0xFFFF, 9)) == [(10, 0, 1.0, 0.0), (10, 1, 0.0, 0.0)]
    found = states(bus, sync(10), report(10, 3, 400, 10))
    assert found == [(20010, 0, 1.0, 0.0), (16010, 1, 1.0, 1.0), (20010, 1, 1.0, 0.0)]
    assert bus.status()["thruster2"] == {"accepted": 2, "rejected": 0, "open": 1.0}


def test_a_lost_report_costs_nothing_where_one_change_lies_in_the_gap() -> None:
    bus = source()
    states(bus, sync(0), report(0, 0, 0xFFFF, 255))
    found = states(bus, sync(40), report(40, 2, 5000, 0))
    assert found == [(80010, 0, 0.0, 0.0), (30010, 1, 1.0, 1.0), (80010, 1, 1.0, 0.0)]


@pytest.mark.parametrize(
    ("age", "changes"),
    [(400, 2), (0xFFFF, 1), (3000, 1), (2001, 1), (400, 0)],
    ids=["two", "old", "early", "at the latch before, rounded", "none"],
)
def test_changes_whose_times_are_not_known_are_told_as_such(age: int, changes: int) -> None:
    bus = source()
    states(bus, sync(0), report(0, 0, 0xFFFF, 0))
    unknown = [on for _, _, on, _ in states(bus, sync(10), report(10, 0, age, changes))]
    assert np.isnan(unknown).any() == ((age, changes) not in ((2001, 1), (400, 0)))


@pytest.mark.parametrize(
    "bad",
    [
        report(0, 1, 0, 1, status=0),
        report(0, 1, 0, 1, status=0x18),
        report(5, 1, 0, 1),
        CanFrame(T0 + 1, 0x1B1, b"\0" * 7),
        CanFrame(T0 + 1, 0x1B1, report(0, 1, 0, 1).data + bytes(4), is_fd=True),
    ],
)
def test_a_bad_report_is_rejected_and_counted(bad: CanFrame) -> None:
    bus = source()
    assert states(bus, sync(0), bad) == []
    assert bus.status()["thruster1"]["rejected"] == 1
    assert len(states(bus, sync(1), report(1, 0, 0xFFFF, 0))) == 2


def test_a_silent_node_is_found_and_its_frames_are_its_own() -> None:
    bus = source()
    states(bus, sync(0), report(0, 0, 0xFFFF, 0))
    assert bus.findings() == []
    bus.feed(frame_array([sync(k) for k in range(1, 60)]))
    bus.watch(sync(59).t_ns, up=True)
    (found,) = bus.findings()
    assert (found.fault, found.subject) == (Fault.THRUSTER_SILENT, "thruster1")
    frames = frame_array([sync(0), report(0, 0, 0, 0), CanFrame(T0, 0x191, b"\0" * 8)])
    assert bus.owns(frames).tolist() == [False, True, False]
