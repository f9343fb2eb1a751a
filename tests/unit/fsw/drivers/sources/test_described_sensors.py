"""Inertial units and star trackers of other makers on a CAN bus: cantools encodes the frames."""

import struct
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from fsw.config import Config, ImuConfig, Mounting, StarTrackerConfig
from fsw.drivers.sources.described_sensors import SensorBusSource
from fsw.drivers.sources.devices import other_sources
from fsw.drivers.wire import CanFrame, frame_array
from fsw.errors import ConfigError
from fsw.messages import AttitudeSamples, ImuSamples, joined
from tests.support.bus_traffic import cut
from tests.support.driver_configs import bus_config, imu_config, star_tracker_config

MS = 1_000_000
T0 = 10**12
RATE_HZ = 200.0
PERIOD_NS = 5 * MS
G = 9.80665
# the form of a real unit: time and status, specific force, rates in three frames
DBC = """VERSION ""
NS_ :
BS_:
BU_: A

BO_ 288 Head: 8 A
 SG_ Clock : 0|32@1+ (1,0) [0|0] "us" A
 SG_ Flags : 32|16@1+ (1,0) [0|0] "" A

BO_ 289 Accel: 6 A
 SG_ X : 0|16@1- (0.01,0) [0|0] "m/s²" A
 SG_ Y : 16|16@1- (0.01,0) [0|0] "m/s²" A
 SG_ Z : 32|16@1- (0.01,0) [0|0] "m/s²" A

BO_ 290 Gyro: 6 A
 SG_ X : 7|16@0- (0.02,0) [0|0] "deg/s" A
 SG_ Y : 23|16@0- (0.02,0) [0|0] "deg/s" A
 SG_ Z : 39|16@0- (0.02,0) [0|0] "deg/s" A

BO_ 291 AccelInG: 6 A
 SG_ X : 0|16@1- (0.001,0) [0|0] "g" A
 SG_ Y : 16|16@1- (0.001,0) [0|0] "g" A
 SG_ Z : 32|16@1- (0.001,0) [0|0] "g" A

BO_ 2147483968 Attitude: 8 A
 SG_ Q0 : 0|16@1- (3.0518509475997e-05,0) [0|0] "" A
 SG_ Q1 : 16|16@1- (3.0518509475997e-05,0) [0|0] "" A
 SG_ Q2 : 32|16@1- (3.0518509475997e-05,0) [0|0] "" A
 SG_ Q3 : 48|16@1- (3.0518509475997e-05,0) [0|0] "" A

BO_ 2147483969 State: 1 A
 SG_ Valid : 0|1@1+ (1,0) [0|0] "" A
"""
DATABASE = cantools.database.load_string(DBC, "dbc")


def vector(role: str, message: str, **more: Any) -> dict[str, Any]:
    return {f"{role}_{axis}": {"message": message, "signal": axis.upper()} | more for axis in "xyz"}


def unit(**changes: Any) -> ImuConfig:
    timing = {"by": "arrival", "sigma_s": 1e-4}
    signals = vector("rate", "Gyro") | vector("force", "Accel")
    own = {"driver": "described", "bus": "arm", "port": None, "rate_hz": RATE_HZ}
    return imu_config(**(own | {"signals": signals, "timing": timing} | changes))


def tracker(order: str = "wxyz", **changes: Any) -> StarTrackerConfig:
    signals = {
        f"q_{name}": {"message": "Attitude", "signal": f"Q{k}"} for k, name in enumerate(order)
    }
    own = {"driver": "described", "bus": "arm", "port": None, "signals": signals}
    timing = {"by": "arrival", "sigma_s": 1e-4}
    return star_tracker_config(**(own | {"timing": timing} | changes))


def made(tmp_path: Path, bus: dict[str, Any] | None = None, **devices: Any) -> SensorBusSource:
    keys = {"rate_hz": RATE_HZ, "sync": "none", "description": "robot.dbc"} | (bus or {})
    own = bus_config(**keys)
    (tmp_path / "robot.dbc").write_text(DBC, encoding="utf-8")
    config = Config.model_construct(buses=(own,), **devices).read_from(b"", tmp_path, "c")
    (source,) = other_sources(config, own)
    assert isinstance(source, SensorBusSource)
    return source


def frame(t_ns: float, name: str, *values: float) -> CanFrame:
    message = DATABASE.get_message_by_name(name)
    named = dict(zip((signal.name for signal in message.signals), values, strict=True))
    data = message.encode(named, strict=False)
    return CanFrame(round(t_ns), message.frame_id, data, is_extended=message.is_extended_frame)


def motion(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rates [deg/s] and specific forces [m/s^2], on the steps of the wire."""
    phase = 0.05 * np.arange(count)[:, None] + np.arange(3)
    return np.round(np.sin(phase) * 30 / 0.02) * 0.02, np.round(np.cos(phase) * 400) * 0.01


def stream(rng: np.random.Generator, count: int, *, lost: float = 0.0) -> list[CanFrame]:
    rates, forces = motion(count)
    frames = []
    for k in range(count):
        sent_ns = T0 + PERIOD_NS * k + 95e3 + rng.exponential(1e5)  # of 95 bits, and late
        frames += [frame(sent_ns, "Gyro", *rates[k]), frame(sent_ns + 1e5, "Accel", *forces[k])]
    return [own for own in frames if rng.random() >= lost]


def test_rates_and_forces_of_two_frames_are_timed_and_calibrated(tmp_path):
    turn = ((1.01, 0.0, 0.02), (0.0, 0.99, 0.0), (0.0, 0.0, 1.0))
    own = unit(
        gyro_bias_S_rad_s=(0.01, 0.0, -0.02), acc_bias_S_m_s2=(0.0, 0.1, 0.0), gyro_matrix=turn
    )
    source = made(tmp_path, imu=own)
    samples = source.feed(frame_array(stream(np.random.default_rng(1), 400)))
    assert isinstance(samples, ImuSamples)
    rates, forces = motion(400)
    expected = (np.radians(rates) - [0.01, 0.0, -0.02]) @ np.array(turn).T
    np.testing.assert_allclose(samples.w_NS_S_rad_s, expected, atol=1e-12)
    np.testing.assert_allclose(samples.f_NS_S_m_s2, forces - [0.0, 0.1, 0.0], atol=1e-12)
    times_ns = T0 + PERIOD_NS * np.arange(400)
    for t_ns, delay_ns in ((samples.t_gyro_ns, 2_200_000), (samples.t_acc_ns, 6_300_000)):
        assert np.abs(t_ns - times_ns + delay_ns)[200:].max() < 20_000
    counters = source.counters
    assert [counters[key] for key in ("accepted", "rejected", "lost")] == [400, 0, 0]
    assert source.findings() == []


def test_forces_in_g(tmp_path):
    signals = vector("rate", "Gyro") | vector("force", "AccelInG")
    source = made(tmp_path, imu=unit(signals=signals))
    samples = source.feed(
        frame_array([frame(T0, "Gyro", 0, 0, 0), frame(T0 + 1e5, "AccelInG", 0.5, -1.0, 2.0)])
    )
    np.testing.assert_allclose(samples.f_NS_S_m_s2, [[0.5 * G, -G, 2.0 * G]], atol=1e-9)


def test_its_own_clock_and_its_status_in_a_third_frame(tmp_path):
    rng = np.random.default_rng(2)
    rates, forces = motion(1000)
    status = {"message": "Head", "signal": "Flags", "mask": 1, "value": 1}
    signals = vector("rate", "Gyro") | vector("force", "Accel") | {"status": status}
    signals["time"] = {"message": "Head", "signal": "Clock"}
    timing = {"by": "device_time", "sigma_s": 1e-5}
    own = unit(signals=signals, timing=timing, gyro_group_delay_s=0.0, acc_group_delay_s=0.0)
    source = made(tmp_path, imu=own)
    frames, bad = [], {300, 301, 700}
    for k in range(1000):
        sent_ns = T0 + PERIOD_NS * k + 95e3 + rng.exponential(5e5)
        clock_us = (k * 5000.0 + 4_294_000_000) % 2**32  # it wraps
        frames += [
            frame(sent_ns, "Head", clock_us, 0 if k in bad else 3),
            frame(sent_ns + 1e5, "Accel", *forces[k]),
            frame(sent_ns + 2e5, "Gyro", *rates[k]),
        ]
    samples = source.feed(frame_array(frames))
    good = [k for k in range(1000) if k not in bad]
    np.testing.assert_allclose(samples.w_NS_S_rad_s, np.radians(rates)[good], atol=1e-12)
    late_ns = samples.t_gyro_ns - T0 - PERIOD_NS * np.array(good)
    assert np.ptp(late_ns[200:]) < 60_000
    assert source.counters["reject_status"] == 3
    assert [found.fault for found in source.findings()] == ["GYRO_FAULT"] * 3


def test_batches_do_not_matter_and_losses_are_counted(tmp_path):
    rng = np.random.default_rng(3)
    frames = stream(rng, 300, lost=0.03)
    whole, parts = made(tmp_path, imu=unit()), made(tmp_path, imu=unit())
    once = whole.feed(frame_array(frames))
    many = joined([parts.feed(frame_array(frames[own])) for own in cut(rng, len(frames), 7.0)])
    for name in ("t_gyro_ns", "t_acc_ns", "t_receive_ns", "w_NS_S_rad_s", "f_NS_S_m_s2"):
        np.testing.assert_array_equal(getattr(once, name), getattr(many, name))
    assert whole.counters == parts.counters
    rates = 300 - sum(own.can_id == 290 for own in frames)
    assert whole.counters["lost"] == rates > 3
    assert 3 < whole.counters["incomplete"] <= rates
    forces = np.isnan(once.f_NS_S_m_s2).all(axis=1)
    assert forces.sum() > 3
    faults = [found.fault for found in whole.findings()]
    assert (faults.count("IMU_LOST") > 3, faults.count("ACC_FAULT")) == (True, forces.sum())
    assert {found.subject for found in whole.findings()} <= {"imu"}


def test_an_impossible_reading_and_a_short_frame_are_rejected_and_found(tmp_path):
    source = made(tmp_path, imu=unit(max_rate_rad_s=1.0))
    frames = stream(np.random.default_rng(4), 5)
    frames[2] = frame(frames[2].t_ns, "Gyro", 90.0, 0.0, 0.0)
    frames[6] = CanFrame(frames[6].t_ns, frames[6].can_id, frames[6].data[:5])
    assert len(source.feed(frame_array(frames))) == 3
    counters = source.counters
    assert (counters["reject_range"], counters["reject_length"]) == (1, 1)
    assert [found.fault for found in source.findings()] == ["IMU_CRC", "IMU_RANGE", "IMU_LOST"]


def test_a_silent_unit_is_found_even_if_nothing_on_its_bus_was_ever_heard(tmp_path):
    source = made(tmp_path, imu=unit())
    source.watch(T0, up=True)
    assert source.findings() == []
    source.watch(T0 + 6000 * MS, up=True)
    assert [found.fault for found in source.findings()] == ["IMU_SILENT"]
    source.watch(T0 + 7000 * MS, up=False)
    source.watch(T0 + 8000 * MS, up=True)
    assert source.findings() == []  # it may start again


def test_a_value_that_the_unit_calls_invalid_is_named_so(tmp_path):
    signals = {
        f"q_{name}": {"message": "Attitude", "signal": f"Q{k}"} for k, name in enumerate("wxyz")
    }
    signals["q_z"]["invalid"] = 0
    source = made(tmp_path, star_tracker=tracker(signals=signals))
    assert len(source.feed(frame_array([frame(T0, "Attitude", 1, 0, 0, 0)]))) == 0
    (found,) = source.findings()
    assert (found.fault, found.text) == ("TRACKER_BLIND", "no usable value")


def test_a_unit_on_a_bus_whose_sync_creeps_reports_the_bus(tmp_path):
    signals = vector("rate", "Gyro") | vector("force", "Accel")
    signals["counter"] = {"message": "Head", "signal": "Flags"}
    own = unit(signals=signals, timing={"by": "echoed_counter"}, rate_hz=500.0)
    bus = {"rate_hz": 500.0, "sync": "producer", "sync_counter_max": 240}
    source, frames = made(tmp_path, bus, imu=own), []
    for k in range(12_500):
        t_ns, counter = T0 + 2 * MS * k, k % 240 + 1
        crept_ns = round(50e3 * max(0.0, 2e-3 * k - 15.0))
        frames += [
            CanFrame(t_ns + crept_ns, 0x80, bytes([counter])),
            CanFrame(t_ns + 300_000, 288, struct.pack("<IHH", 0, counter, 0)),
            CanFrame(t_ns + 400_000, 289, bytes(6)),
            CanFrame(t_ns + 500_000, 290, bytes(6)),
        ]
    source.feed(frame_array(frames))
    assert {(one.fault, one.subject) for one in source.findings()} == {("SYNC_CREEPS", "arm")}


def test_equal_readings_are_judged_only_where_noise_hides_the_steps(tmp_path):
    fine = {"angle_random_walk_rad_sqrt_s": 1.0, "velocity_random_walk_m_s_sqrt_s": 1.0}
    assert made(tmp_path, imu=unit(**fine)).is_screened
    for coarse in fine:
        assert not made(tmp_path, imu=unit(**(fine | {coarse: 1e-4}))).is_screened


def test_the_steps_behind_a_float_are_not_taken_as_fine(tmp_path):
    messages = [
        {"name": name, "id": 0x300 + i, "length": 6}
        | {
            "signals": [
                {"name": axis, "start": 16 * k, "bits": 16, "number": "float", "unit": one}
                for k, axis in enumerate("XYZ")
            ]
        }
        for i, (name, one) in enumerate((("Gyro", "rad/s"), ("Accel", "m/s^2")))
    ]
    bus = {"description": None, "messages": messages}
    fine = {"angle_random_walk_rad_sqrt_s": 1.0, "velocity_random_walk_m_s_sqrt_s": 1.0}
    assert not made(tmp_path, bus, imu=unit()).is_screened
    assert made(tmp_path, bus, imu=unit(**fine)).is_screened


@pytest.mark.parametrize("rotation", ["inertial_to_tracker", "tracker_to_inertial"])
@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_attitudes_in_any_order_of_components(tmp_path, order, rotation):
    mounting = Mounting(p_BS_m=(0, 0, 0), rpy_BS_rad=(0.3, -0.2, 1.0))
    own = tracker(order, rotation=rotation, mounting=mounting)
    true = Rotation.from_euler("xyz", [[0.1 * k, 0.2, -0.3] for k in range(40)])
    R_BS = Rotation.from_quat(mounting.q_BS_xyzw)
    shown = true * R_BS
    shown = shown if rotation == "tracker_to_inertial" else shown.inv()
    at = ["xyzw".index(name) for name in order]
    frames = [frame(T0 + 100 * MS * k, "Attitude", *q[at]) for k, q in enumerate(shown.as_quat())]
    frames[20] = frame(frames[20].t_ns, "Attitude", 0, 0, 0, 0)
    good = [k for k in range(40) if k != 20]
    source = made(tmp_path, star_tracker=own)
    samples = source.feed(frame_array(frames))
    assert isinstance(samples, AttitudeSamples)
    error = (true[good].inv() * Rotation.from_quat(samples.q_NB_xyzw)).magnitude()
    assert error.max() < 1e-4
    assert np.abs(samples.t_ns - T0 - 100 * MS * np.array(good) + 100 * MS).max() < MS
    assert source.counters["reject_range"] == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bus": None}, "bus: missing with driver: described"),
        ({"port": "/dev/ttyS0"}, "port: '/dev/ttyS0' must be left out with driver: described"),
        ({"timing": None}, "timing: missing with driver: described"),
        ({"node_id": 3}, "node_id: 3 must be left out with driver: described"),
        ({"signals": vector("rate", "Gyro")}, "signals.force_x: missing with a sensor"),
        (
            {"signals": vector("rate", "Gyro") | vector("force", "Accel")
             | {"position": {"message": "Gyro", "signal": "X"}}},
            "signals.position: has no use with a sensor",
        ),
        ({"driver": "stim300", "bus": None}, "signals: it must be left out with driver: stim300"),
    ],
)  # fmt: skip
def test_keys_that_do_not_go_together(changes, words):
    with pytest.raises(ValidationError, match=words):
        unit(**changes)


def test_a_signal_of_another_quantity_is_named(tmp_path):
    wrong = vector("rate", "Gyro") | vector("force", "Accel", unit="deg/s")
    with pytest.raises(ConfigError, match=r"^imu.signals.force_x.unit: 'deg/s', but the descr"):
        made(tmp_path, imu=unit(signals=wrong))
