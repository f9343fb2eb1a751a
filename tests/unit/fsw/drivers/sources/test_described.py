"""Joints of foreign devices: frames are encoded here by struct, or by cantools from a DBC."""

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from fsw.config import Config, JointConfig
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.wire import CanFrame, frame_array
from fsw.errors import ConfigError
from fsw.messages import JointSamples, joined
from tests.support.bus_traffic import cut
from tests.support.driver_configs import bus_config, joint_config

MS = 1_000_000
T0 = 10**12
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
""" + "".join(
    f"""
BO_ {axis << 5 | 9} Axis{axis}_Encoder: 8 A
 SG_ Pos : 0|32@1- (1,0) [0|0] "rev" A
 SG_ Vel : 32|32@1- (1,0) [0|0] "rev/s" A

BO_ {axis << 5 | 28} Axis{axis}_Torques: 8 A
 SG_ Target : 0|32@1- (1,0) [0|0] "Nm" A
 SG_ Estimate : 32|32@1- (1,0) [0|0] "Nm" A
"""
    for axis in range(2)
) + "".join(
    f"SIG_VALTYPE_ {axis << 5 | number} {name} : 1;\n"
    for axis in range(2)
    for number, name in ((9, "Pos"), (9, "Vel"), (28, "Target"), (28, "Estimate"))
)  # fmt: skip


def made(tmp_path: Path, bus: dict[str, Any], joints: Sequence[dict[str, Any]]) -> Any:
    """Return the source of described joints, without the rest of a configuration."""
    own = bus_config(**({"rate_hz": 100.0, "sync": "none"} | bus))
    base = {"node_id": None, "driver": "described", "speed_limit_rad_s": 3.0}
    configs = tuple(
        JointConfig(**(joint_config(1).model_dump() | base | {"name": f"j{k}"} | joint))
        for k, joint in enumerate(joints)
    )
    (tmp_path / "robot.dbc").write_text(DBC)
    config = Config.model_construct(buses=(own,), joints=configs).read_from(b"", tmp_path, "c")
    layouts = layouts_of(config, own)
    return DescribedBusSource(own, list(enumerate(configs)), layouts)


def use(message: str, signal: str, **more: Any) -> dict[str, Any]:
    return {"message": message, "signal": signal, **more}


def odrive(axis: int, **timing: Any) -> dict[str, Any]:
    return {
        "signals": {
            "position": use(f"Axis{axis}_Encoder", "Pos"),
            "torque": use(f"Axis{axis}_Torques", "Estimate"),
        },
        "timing": {"by": "arrival", "sigma_s": 1e-4} | timing,
    }


def odrive_frames(
    rng: np.random.Generator, count: int, period_ns: float = 10.003 * MS
) -> tuple[list[CanFrame], dict[int, np.ndarray]]:
    """Return frames of two free-running axes and their true times [ns]."""
    frames, times = [], {}
    for axis, phase in ((0, 1.7), (1, 6.1)):
        times[axis] = T0 + phase * MS + period_ns * np.arange(count)
        for k, t_ns in enumerate(times[axis]):
            turns, torque = 0.05 * math.sin(0.02 * k + axis), 2.0 + 0.1 * rng.standard_normal()
            sent = t_ns + 111e3 + rng.exponential(2e5)  # 111 bits at 1 Mbit/s
            one = struct.pack("<ff", turns, 0.0)
            two = struct.pack("<ff", 0.0, torque)
            frames.append(CanFrame(round(sent), axis << 5 | 9, one))
            frames.append(CanFrame(round(sent + 120e3), axis << 5 | 28, two))
    return sorted(frames, key=lambda frame: frame.t_ns), times


def test_samples_of_two_frames_by_arrival(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frames, times = odrive_frames(rng, 1000)
    source = made(tmp_path, {"description": "robot.dbc"}, [odrive(0), odrive(1)])
    samples = source.feed(frame_array(frames))
    assert len(samples) == 2000
    counters = source.counters
    assert (counters["accepted"], counters["rejected"], counters["lost"]) == (2000, 0, 0)
    for axis in (0, 1):
        own = samples.joint == axis
        phase = 0.02 * np.arange(1000) + axis
        expected = 0.05 * math.tau * np.sin(phase)
        assert np.abs(samples.position_rad[own] - expected).max() < 1e-6
        assert np.abs(samples.torque_nm[own] - 2.0).max() < 0.6
        late_ns = samples.t_ns[own] - times[axis]
        # the least of ~100 delays of mean 0.2 ms is near 2 us; before the line settles it is worse
        assert np.abs(late_ns[200:]).max() < 50e3


PAGES = """VERSION ""
NS_ :
BS_:
BU_: A

BO_ 640 Drive: 8 A
 SG_ Page M : 0|4@1+ (1,0) [0|0] "" A
 SG_ Fault : 4|4@1+ (1,0) [0|0] "" A
 SG_ Angle m0 : 8|32@1- (0.0001,0) [0|0] "deg" A
 SG_ Torque m1 : 8|16@1- (0.01,0) [0|0] "Nm" A
 SG_ Motor m2 : 8|16@1- (0.1,0) [0|0] "degC" A
"""


@pytest.mark.parametrize("by", ["arrival", "last_sync"])
def test_pages_of_one_message_are_joined_as_two_messages_are(tmp_path: Path, by: str) -> None:
    database = cantools.database.load_string(PAGES, "dbc")
    (tmp_path / "pages.dbc").write_text(PAGES)
    rng, frames, count = np.random.default_rng(4), [], 300
    lost = {(150, "Torque"), (200, "Angle")}
    for k in range(count):
        t_ns = T0 + 10 * MS * k
        frames.append(CanFrame(t_ns, 0x80, b""))
        sent_ns = t_ns + 200_000 + round(rng.exponential(5e4))
        values = {"Angle": 10.0 * math.sin(0.02 * k), "Torque": 2.0 + 0.01 * k, "Motor": 40.0}
        for page, (name, value) in enumerate(values.items()):
            data = database.encode_message(
                "Drive", {"Page": page, "Fault": 5 * (page != 0), name: value}
            )
            if (k, name) not in lost:
                frames.append(CanFrame(sent_ns + 300_000 * page, 640, data))
    status = use("Drive", "Fault", mask=15, value=0)
    signals = {"position": use("Drive", "Angle"), "torque": use("Drive", "Torque")}
    timing = {"by": by} | ({"sigma_s": 1e-4} if by == "arrival" else {})
    bus = {"description": "pages.dbc", "sync": "consumer", "sync_counter_max": 0}
    joint = {"signals": signals | {"status": status}, "timing": timing}
    source = made(tmp_path, bus, [joint])
    parts = [source.feed(frame_array(frames[at : at + 7])) for at in range(0, len(frames), 7)]
    samples = joined(parts)
    kept = np.array([k for k in range(count) if k != 200][: len(samples)])
    assert len(kept) >= count - 3  # of the last ones the other page is waited for
    expected = np.where(kept == 150, np.nan, 2.0 + 0.01 * kept)
    np.testing.assert_allclose(
        samples.position_rad, np.radians(10 * np.sin(0.02 * kept)), atol=1e-6
    )
    np.testing.assert_allclose(samples.torque_nm, expected, atol=5.1e-3)
    counters = source.counters
    assert [counters[key] for key in ("rejected", "incomplete", "torque_unusable")] == [0, 1, 1]
    assert [found.fault for found in source.findings()] == ["TORQUE_FAULT", "JOINT_LOST"]


def test_batches_do_not_matter(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    frames, _ = odrive_frames(rng, 300)
    frames = [frame for frame in frames if rng.random() > 0.03]  # some are lost
    joints = [odrive(0), odrive(1)]
    whole = made(tmp_path, {"description": "robot.dbc"}, joints)
    parts = made(tmp_path, {"description": "robot.dbc"}, joints)
    once = whole.feed(frame_array(frames))
    many = joined([parts.feed(frame_array(frames[own])) for own in cut(rng, len(frames), 7.0)])
    assert sorted(_rows(once)) == sorted(_rows(many))
    assert whole.counters == parts.counters
    counters = whole.counters
    assert counters["lost"] > 5
    assert counters["torque_unusable"] > 3
    assert counters["incomplete"] > 3


def _rows(samples: JointSamples) -> list[tuple[float, ...]]:
    torque = np.nan_to_num(samples.torque_nm, nan=-99.0)
    columns = (samples.t_ns, samples.t_receive_ns, samples.joint, samples.position_rad, torque)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def test_a_late_frame_keeps_its_place_and_an_early_one_has_none(tmp_path: Path) -> None:
    frames, times = odrive_frames(np.random.default_rng(3), 400)
    late = [frame for frame in frames if frame.can_id in (9, 28)]
    for k in (200, 300):  # the frames of one sample, late by 0.7 of a period
        for at in (2 * k, 2 * k + 1):
            moved = late[at]
            late[at] = CanFrame(moved.t_ns + 7 * MS, moved.can_id, moved.data)
    late.insert(700, CanFrame(late[699].t_ns + 4 * MS, 9, late[698].data))  # nobody's
    late.insert(701, CanFrame(late[699].t_ns + 4 * MS + 9, 28, late[699].data))
    source = made(tmp_path, {"description": "robot.dbc"}, [odrive(0)])
    samples = source.feed(frame_array(late))
    assert len(samples) == 400
    assert np.abs(samples.t_ns[100:] - times[0][100:]).max() < 50e3
    assert source.counters["reject_stale"] == 1


MIT = [
    {
        "name": f"reply{k}",
        "id": 0x028000FD | k << 8,
        "extended": True,
        "length": 8,
        "signals": [
            {"name": "position", "start": 15, "bits": 16, "order": "big", "range": [-12.5, 12.5]},
            {"name": "torque", "start": 35, "bits": 12, "order": "big", "range": [-10.0, 10.0]},
            {"name": "stamp", "start": 55, "bits": 16, "order": "big", "scale": 10, "unit": "us"},
            {"name": "fault", "start": 4, "bits": 4},
        ],
    }
    for k in (1, 2)
]


def test_packed_fields_with_a_device_time_that_drifts_and_wraps(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    joint = {
        "position_noise_rad": 1.1e-4,  # its step is 0.38 mrad
        "signals": {
            "position": use("reply1", "position", unit="rad"),
            "torque": use("reply1", "torque", unit="N m"),
            "time": use("reply1", "stamp"),
            "status": use("reply1", "fault", mask=15, value=0),
        },
        "timing": {"by": "device_time", "sigma_s": 2e-5},
    }
    true_ns = T0 + 3.3 * MS + 5.0 * MS * np.arange(2000)
    frames, positions, torques = [], [], list[float]()
    for k, t_ns in enumerate(true_ns):
        p, tau = round(32768 + 3000 * math.sin(0.01 * k)), int(rng.integers(2000, 2090))
        stamp = round((t_ns - T0) * (1 + 2e-4) / 1e4) + 60_000  # 10 us, 200 ppm fast
        fault = 3 if k in (700, 701) else 0
        word = fault << 60 | p << 40 | 0x800 << 28 | tau << 16 | stamp & 0xFFFF
        sent = t_ns + 131e3 + rng.exponential(3e5)
        data = word.to_bytes(8, "big")
        frames.append(CanFrame(round(sent), 0x028001FD, data, is_extended=True))
        frames.append(CanFrame(round(sent) + 1000, 0x028001FD & 0x7FF, data))  # another's
        frames.append(CanFrame(round(sent) + 1000, 0x028002FD, data, is_extended=True))
        positions.append(p / 65535 * 25.0 - 12.5)
        torques.append(tau / 4095 * 20.0 - 10.0)
    bus = {"messages": MIT, "rate_hz": 200.0}
    source = made(tmp_path, bus, [joint])
    samples = source.feed(frame_array(frames))
    good = np.delete(np.arange(2000), [700, 701])
    assert source.counters["reject_status"] == 2
    assert np.abs(samples.position_rad - np.array(positions)[good]).max() < 1e-12
    assert np.abs(samples.torque_nm - np.array(torques)[good]).max() < 1e-12
    late_ns = samples.t_ns - true_ns[good]
    assert np.abs(late_ns[300:]).max() < 30e3  # its unit is 10 us, the least delay a few us
    assert source.counters["lost"] == 2


def shared(k: int) -> dict[str, Any]:
    return {
        "torque": "none",
        "signals": {"position": use("pair", f"angle{k}", unit="0.001 deg")},
        "timing": {"by": "last_sync"},
    }


PAIR = {
    "name": "pair",
    "id": 0x2A5,
    "length": 8,
    "signals": [
        {"name": f"angle{k}", "start": 7 + 32 * k, "bits": 32, "order": "big", "number": "signed"}
        for k in (0, 1)
    ],
}


def test_joints_that_share_a_frame_take_the_time_of_the_last_sync(tmp_path: Path) -> None:
    frames = []
    for k in range(300):
        t_ns = T0 + 10 * MS * k
        if k != 200:  # a SYNC that was missed: its answer comes a period after the one before
            frames.append(CanFrame(t_ns, 0x080, b""))
        delay = 9_500_000 if k == 100 else 700_000
        data = struct.pack(">ii", 20 * k, -1999)
        frames.append(CanFrame(t_ns + delay, 0x2A5, data))
    bus = {"messages": [PAIR], "sync": "consumer", "sync_counter_max": 0, "latch_offset_s": 1e-5}
    source = made(tmp_path, bus, [shared(0), shared(1)])
    samples = source.feed(frame_array(frames))
    assert len(samples) == 2 * 298
    assert source.counters["reject_stale"] == 4
    first = samples.joint == 0
    kept = np.delete(np.arange(300), [100, 200])
    assert (samples.t_ns[first] == T0 + 10 * MS * kept + 10_000).all()
    assert np.allclose(samples.position_rad[first], np.radians(0.020 * kept), atol=1e-12)
    assert np.allclose(samples.position_rad[~first], math.radians(-1.999), atol=1e-12)
    assert np.isnan(samples.torque_nm).all()


@pytest.mark.parametrize(
    ("role", "given", "raw", "value"),
    [
        ("position", {"unit": "counts", "counts_per_rev": 4096}, 1024, math.pi / 2),
        ("position", {"unit": "rev"}, 1, math.tau),
        ("position", {"unit": "deg"}, 90, math.pi / 2),
        ("position", {"unit": "0.001°"}, 90_000, math.pi / 2),
        ("torque", {"unit": "permille", "rated_torque_nm": 40.0}, -250, -10.0),
        ("torque", {"unit": "mN m"}, 1500, 1.5),
        ("torque", {"unit": "mA", "nm_per_a": 8.0}, 500, 4.0),
    ],
)
def test_units_of_a_signal(
    tmp_path: Path, role: str, given: dict[str, Any], raw: int, value: float
) -> None:
    joint = shared(0)
    joint["signals"]["position"] = use("pair", "angle0", unit="mrad")
    if role == "torque":
        joint["torque"] = "link_side"
        joint["signals"]["torque"] = use("pair", "angle1", unit="nm")
    joint["signals"][role] |= {"unit": None} | given
    bus = {"messages": [PAIR], "sync": "consumer"}
    source = made(tmp_path, bus, [joint])
    data = struct.pack(">ii", raw if role == "position" else 0, raw)
    found = source.feed(frame_array([CanFrame(T0, 0x080, b"\1"), CanFrame(T0 + MS, 0x2A5, data)]))
    assert getattr(found, "position_rad" if role == "position" else "torque_nm") == [
        pytest.approx(value, rel=1e-12)
    ]


@pytest.mark.parametrize(
    ("unit", "is_right"), [("rev", True), ("0.001 deg", False), ("deg", False)]
)
def test_a_unit_that_contradicts_the_description_is_refused(
    tmp_path: Path, unit: str, is_right: bool
) -> None:
    """A manual says 0.001 deg of the raw number; the scale of the file has it already."""
    joint = odrive(0)
    joint["signals"]["position"]["unit"] = unit
    bus = {"description": "robot.dbc"}
    if is_right:
        assert made(tmp_path, bus, [joint])
        return
    with pytest.raises(
        ConfigError, match=rf"position.unit: '{unit}', but the description says 'rev'"
    ):
        made(tmp_path, bus, [joint])


def test_a_short_frame_and_a_silent_joint_are_reported(tmp_path: Path) -> None:
    frames, _ = odrive_frames(np.random.default_rng(5), 50)
    frames[30] = CanFrame(frames[30].t_ns, frames[30].can_id, frames[30].data[:7])
    source = made(tmp_path, {"description": "robot.dbc"}, [odrive(0), odrive(1)])
    source.feed(frame_array(frames))
    assert source.counters["reject_length"] == 1
    assert {found.fault.value for found in source.findings()} >= {"JOINT_LENGTH"}
    source.watch(frames[-1].t_ns + 20 * MS, up=True)
    assert not source.findings()
    source.watch(frames[-1].t_ns + 60 * MS, up=True)
    assert [found.fault.value for found in source.findings()] == ["JOINT_SILENT"] * 2
    source.watch(frames[-1].t_ns + 70 * MS, up=True)
    assert not source.findings()


def test_a_joint_that_was_never_heard_is_found(tmp_path: Path) -> None:
    source = made(tmp_path, {"description": "robot.dbc"}, [odrive(0)])
    for at_ns, count in ((0, 0), (4_000 * MS, 0), (5_001 * MS, 1), (5_002 * MS, 0)):
        source.watch(T0 + at_ns, up=True)
        assert [found.fault for found in source.findings()] == ["JOINT_SILENT"] * count
