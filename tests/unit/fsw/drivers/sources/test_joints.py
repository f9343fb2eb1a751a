import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.sources.joint_calibration import Calibration
from fsw.drivers.wire import CanFrame
from tests.support.driver_configs import bus_config, joint_config
from tests.support.encoders import tpdo1, tpdo1_fd
from tests.support.samples import Row, RowSource

MS = 1_000_000
T0 = 10**12
QUANTUM = math.tau / 2**24


def source(count: int = 2, bus: dict[str, object] | None = None, **changes: object) -> RowSource:
    joints = [(k, joint_config(0x11 + k, **changes)) for k in range(count)]
    return RowSource(bus_config(**(bus or {})), joints)


def sync(k: int) -> CanFrame:
    return CanFrame(T0 + 2 * MS * k, 0x080, bytes([k % 240 + 1]))


def reading(k: int, joint: int = 0, q: float = 0.1, tau: float = 1.0, status: int = 9,
            delay_ns: int = 300_000) -> CanFrame:  # fmt: skip
    data = tpdo1(q, tau, status, k % 240 + 1)
    return CanFrame(T0 + 2 * MS * k + delay_ns, 0x191 + joint, data)


def cycle(k: int, **changes: float) -> list[CanFrame]:
    return [sync(k), reading(k, 0, **changes), reading(k, 1, **changes)]  # type: ignore[arg-type]


def run(bus: RowSource, ks: range, **changes: float) -> list[Row]:
    return [s for k in ks for s in bus.feed(cycle(k, **changes))]


def test_a_sample_is_valid_at_its_sync_plus_the_latch_offset() -> None:
    bus = source(bus={"latch_offset_s": 1e-5})
    for k, sample in enumerate(run(bus, range(600))[::2]):
        assert sample.t_ns == T0 + 2 * MS * k + 10_000
        assert sample.t_receive_ns == T0 + 2 * MS * k + 300_000
    counters = bus.counters
    assert (counters["accepted"], counters["rejected"], counters["lost"]) == (1200, 0, 0)


def test_a_late_frame_keeps_the_time_of_its_own_sync() -> None:
    bus = source(1)
    bus.feed([sync(k) for k in range(10)])
    (sample,) = bus.feed([reading(3, delay_ns=15 * MS)])
    assert sample.t_ns == T0 + 6 * MS
    (sample,) = bus.feed([reading(4, delay_ns=17 * MS)])
    assert sample.t_ns == T0 + 8 * MS


def test_a_counter_behind_the_last_one_is_wrong_even_where_its_own_sample_is_missing() -> None:
    bus = source(1)
    bus.feed([sync(k) for k in range(10)])
    assert len(bus.feed([reading(3, delay_ns=15 * MS), reading(5, delay_ns=16 * MS)])) == 2
    assert bus.feed([reading(4, delay_ns=17 * MS)]) == []
    assert bus.counters["reject_sequence"] == 1


@given(
    st.sampled_from([-1, 1]), st.floats(-3, 3), st.floats(0.5, 2), st.floats(-5, 5),
    st.floats(-3, 3), st.floats(-50, 50),
)  # fmt: skip
def test_calibration_is_undone_by_its_inverse(
    sign: int, zero: float, gain: float, offset: float, q: float, tau: float
) -> None:
    config = joint_config(0x11, sign=sign, zero_offset_rad=zero, torque_gain=gain,
                          torque_offset_nm=offset)  # fmt: skip
    raw = np.array([sign * (q + zero)]), np.array([sign * (tau + offset) / gain])
    position, torque = Calibration([joint_config(0x12), config]).apply(np.array([1]), *raw)
    assert position == pytest.approx(q, abs=1e-12)
    assert torque == pytest.approx(tau, abs=1e-10)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (reading(50), "sequence"),
        (reading(40, delay_ns=21 * MS), "sequence"),
        (CanFrame(T0 + 101 * MS, 0x191, bytes(7)), "length"),
        (CanFrame(T0 + 101 * MS, 0x191, bytes(20), is_fd=True), "length"),
        (CanFrame(T0 + 101 * MS, 0x1A5, tpdo1(0.1, 1.0, 9, 51)), "node"),
        (reading(50, status=0x01), "status"),
        (reading(50, status=0x89), "status"),
        (CanFrame(T0 + 101 * MS, 0x191, tpdo1(0.1, 1.0, 9, 0)), "stale"),
        (CanFrame(T0 + 101 * MS, 0x191, tpdo1(0.1, 1.0, 9, 241)), "stale"),
        (CanFrame(T0 + 101 * MS, 0x191, tpdo1(0.1, 1.0, 9, 90)), "stale"),
    ],
)
def test_a_bad_frame_changes_nothing_but_a_counter(bad: CanFrame, reason: str) -> None:
    clean, dirty = source(), source()
    reference = run(clean, range(51)) + run(clean, range(51, 400))
    samples = run(dirty, range(51)) + dirty.feed([bad]) + run(dirty, range(51, 400))
    assert samples == reference
    counters = dirty.counters
    assert counters[f"reject_{reason}"] == counters["rejected"] == 1
    assert counters["lost"] == 0
    assert counters["received_bytes"] == counters["accepted_bytes"] + counters["rejected_bytes"]


@pytest.mark.parametrize("bad", [{"tau": 101.0}, {"q": 0.2}, {"q": -100.0}])
def test_implausible_values_are_out_of_range(bad: dict[str, float]) -> None:
    bus = source(1)
    run_one = [s for k in range(50) for s in bus.feed([sync(k), reading(k)])]
    assert len(run_one) == 50
    bus.feed([sync(50)])
    assert bus.feed([reading(50, **bad)]) == []  # type: ignore[arg-type]
    assert len(bus.feed([reading(50)])) == 1
    assert bus.counters["reject_range"] == 1


def test_a_wrong_first_sample_is_overcome() -> None:
    bus = source(1)
    bus.feed([sync(0), reading(0, q=300.0)])
    accepted = [s for k in range(1, 200) for s in bus.feed([sync(k), reading(k)])]
    assert len(accepted) >= 140
    assert accepted[-1].position_rad == pytest.approx(0.1, abs=QUANTUM)


def test_a_short_burst_of_a_frozen_absurd_value_is_never_believed() -> None:
    bus = source(1)
    for k in range(100):
        bus.feed([sync(k), reading(k)])
    frozen = [s for k in range(100, 140) for s in bus.feed([sync(k), reading(k, q=5.0)])]
    assert frozen == []
    assert len(bus.feed([sync(140), reading(140)])) == 1


def test_a_joint_moving_at_its_limit_after_a_gap_is_accepted() -> None:
    bus = source(1)
    bus.feed([sync(0), reading(0, q=0.0)])
    bus.feed([sync(k) for k in range(1, 500)])
    assert len(bus.feed([reading(499, q=1.9)])) == 1


def test_lost_samples_are_counted_per_joint_and_announced() -> None:
    bus = source(2)
    run(bus, range(100))
    for k in range(100, 400):
        bus.feed([sync(k), reading(k, 1)])
    assert bus.joint_counters[0]["lost"] in range(245, 256)
    assert bus.joint_counters[1]["lost"] == 0
    assert {f.fault for f in bus.findings()} == {"JOINT_SILENT"}
    for k in range(400, 600):
        bus.feed([sync(k), reading(k, 1)])
    run(bus, range(600, 700))
    assert bus.joint_counters[0]["lost"] == 500
    assert {f.fault for f in bus.findings()} == {"JOINT_SILENT"}
    run(bus, range(700, 800))
    assert bus.findings() == []


def test_other_services_are_routed_or_ignored_and_never_rejected() -> None:
    bus = source(1)
    bus.feed(
        [
            CanFrame(T0, 0x711, b"\x00"),
            CanFrame(T0, 0x711, b"\x05"),
            CanFrame(T0, 0x711, b"\x05"),
            CanFrame(T0, 0x091, bytes.fromhex("1023810000000000")),
            CanFrame(T0, 0x291, struct.pack("<ihh", 0, 100, 250)),
            CanFrame(T0, 0x000, b"\x01\x00"),
            CanFrame(T0, 0x591, bytes(8)),
            CanFrame(T0, 0x611, bytes(8)),
            CanFrame(T0, 0x191, bytes(8), is_extended=True),
            CanFrame(T0, 0x191, b"", is_remote=True),
            CanFrame(T0, 0x040, bytes(8), is_error=True),
            CanFrame(T0, 0x1FFFFFFF, bytes(64), is_fd=True),
            CanFrame(T0, 0x080, b""),
            CanFrame(T0, 0x080, b"\xf1"),
        ]
    )
    counters = bus.counters
    assert counters["received"] == counters["rejected"] == 0
    assert counters["sync_invalid"] == 2
    codes = [code for _, code, _ in bus.events()]
    assert codes == ["NODE_BOOT_UP", "NODE_STATE", "NODE_EMERGENCY", "CAN_BUS_OFF"]
    assert bus.events() == []
    assert (counters["error_frames"], counters["can_bus_off"]) == (1, 1)
    assert bus.node_states == {0x11: 5}
    assert [m["temperature_degc"] for m in bus.motor_side().values()] == [25.0]


def test_an_echo_of_a_sync_moves_no_time() -> None:
    clean, dirty = source(), source()
    reference = run(clean, range(300))
    samples = []
    for k in range(300):
        first, *rest = cycle(k)
        echo = CanFrame(first.t_ns + 200_000, first.can_id, first.data)
        samples += dirty.feed([first, echo, *rest])
    assert samples == reference
    assert dirty.counters["lost"] == dirty.counters["rejected"] == 0


def test_a_sync_repeated_after_the_next_one_moves_no_time() -> None:
    """Another producer's repetition is read behind the next SYNC, which was sent before reading."""
    bus = source(1)
    samples = []
    for k in range(300):
        frames = [sync(k + 1), reading(k, delay_ns=2 * MS)]
        if k % 7 == 3:
            frames.append(CanFrame(T0 + 2 * MS * (k + 1), 0x080, bytes([k % 240 + 1])))
            frames.append(reading(k, delay_ns=2 * MS))
        samples += bus.feed([sync(0), *frames] if k == 0 else frames)
    assert [s.t_ns for s in samples] == [T0 + 2 * MS * k for k in range(300)]
    assert bus.counters["sync_lost"] == 0
    assert bus.counters["reject_sequence"] == sum(k % 7 == 3 for k in range(300))


def test_fd_nodes_deliver_the_same() -> None:
    bus = source(1, format="fd")
    frame = CanFrame(T0 + 300_000, 0x191, tpdo1_fd(0.1, 1.5, 0x09, 1), is_fd=True)
    (sample,) = bus.feed([sync(0), frame])
    assert sample.position_rad == pytest.approx(0.1, abs=QUANTUM)
    assert sample.torque_nm == pytest.approx(1.5)


@given(
    st.lists(
        st.builds(
            CanFrame, st.integers(0, 10**9), st.integers(0, 2**29 - 1) | st.integers(0x80, 0x7FF),
            st.binary(max_size=64), st.booleans(), st.booleans(), st.booleans(), st.booleans(),
        ), max_size=40,
    )
)  # fmt: skip
def test_arbitrary_frames_never_raise(frames: list[CanFrame]) -> None:
    bus = source(7)
    bus.feed(frames)
    c = bus.counters
    assert c["accepted"] + c["rejected"] == c["received"]
    assert c["accepted_bytes"] + c["rejected_bytes"] == c["received_bytes"]


def test_the_newest_tpdo2_of_a_joint_is_reported_in_its_own_sign() -> None:
    bus = source(2, sign=-1)
    assert bus.motor_side() == {}
    for torque in (100, -250):
        data = struct.pack("<ihh", 2**24, torque, 215)
        bus.feed([CanFrame(T0, 0x280 + 0x12, data)])
    ((name, motor),) = bus.motor_side().items()
    assert name == joint_config(0x12).name
    assert motor["velocity_rad_s"] == pytest.approx(-math.tau)
    assert motor["motor_torque_ratio"] == pytest.approx(0.25)
    assert motor["temperature_degc"] == pytest.approx(21.5)


@pytest.mark.parametrize("status", [0x08, 0x09, 0x0C])
def test_a_joint_without_torque_sensor_gives_angles_and_no_finding(status: int) -> None:
    bus = source(2, torque="none")
    rows = run(bus, range(5), status=status)
    assert len(rows) == 10
    assert all(row.torque_nm is None for row in rows)
    assert bus.findings() == []
    assert bus.counters["rejected"] == 0


def by_speed(**changes: object) -> RowSource:
    return source(2, encoder="speed", speed_noise_rad_s=0.01, zero_offset_rad=0.0, **changes)


def test_a_joint_known_by_speed_gives_it_in_its_own_sign_and_steps_are_no_faults() -> None:
    """Equal readings, steps and a standstill are what a speed may do; the same batch by batch."""
    speeds = [0.2, 0.2, 0.2, -0.3, -0.3, 0.0, 0.0, 0.0, 0.25]
    together, single = by_speed(sign=-1), by_speed(sign=-1)
    frames = [frame for k, v in enumerate(speeds) for frame in cycle(k, q=v)]
    apart = [row for k, v in enumerate(speeds) for row in single.feed(cycle(k, q=v))]
    for rows in (together.feed(frames), apart):
        for joint in range(2):
            own = [row.position_rad for row in rows if row.joint == joint]
            assert own == pytest.approx([-v for v in speeds], abs=QUANTUM)
    for bus in (together, single):
        assert bus.findings() == []
        assert bus.counters["rejected"] == 0


def test_a_speed_that_no_joint_has_is_out_of_range() -> None:
    bus = by_speed(speed_limit_rad_s=0.5)
    assert len(run(bus, range(3), q=0.55)) == 6
    assert run(bus, range(3, 6), q=0.7) == []
    assert len(run(bus, range(6, 9), q=0.1)) == 6
    assert bus.counters["reject_range"] == 6
    assert {finding.fault for finding in bus.findings()} == {"ENCODER_JUMP"}


def test_a_node_on_can_fd_without_position_gives_the_speed_beside_it() -> None:
    bus = source(1, {"fd": True}, format="fd", encoder="speed", speed_noise_rad_s=0.01,
                 zero_offset_rad=0.0)  # fmt: skip
    frame = CanFrame(T0 + 1, 0x191, tpdo1_fd(0.0, 1.5, 9, 1), is_fd=True)
    (sample,) = bus.feed([sync(0), frame])
    assert sample.position_rad == pytest.approx(1234 * QUANTUM, abs=1e-12)
