import math
import struct

import numpy as np
import pytest
from pydantic import ValidationError

from fsw.config.wheels import WheelConfig
from fsw.drivers.sources.wheels import WheelBusSource
from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages.findings import Fault
from tests.support.driver_configs import bus_config

MS = 1_000_000
T0 = 10**12


def wheel_config(k: int = 0, **changes: object) -> WheelConfig:
    data: dict[str, object] = {
        "name": f"wheel{k + 1}",
        "bus": "arm",
        "node_id": 0x21 + k,
        "rate_hz": 50.0,
        "axis_B": (0.0, 0.0, 1.0),
        "inertia_kg_m2": 0.02,
        "speed_limit_rad_s": 700.0,
        "speed_noise_rad_s": 0.01,
        "torque_limit_nm": 0.4,
        "torque": "measured",
        "torque_noise_nm": 1e-3,
    }
    return WheelConfig.model_validate(data | changes)


def source(**changes: object) -> WheelBusSource:
    wheels = [(k, wheel_config(k, **changes)) for k in range(2)]
    return WheelBusSource(bus_config(latch_offset_s=1e-5), wheels, {})


def sync(k: int) -> CanFrame:
    return CanFrame(T0 + 2 * MS * k, 0x080, bytes([k % 240 + 1]))


def report(k: int, speed: float = 100.0, torque: float = 0.1, status: int = 9, wheel: int = 0,
           delay_ns: int = 300_000) -> CanFrame:  # fmt: skip
    raw = round(speed / math.tau * 2**24), round(torque / 1e-4)
    data = struct.pack("<ihBB", *raw, status, k % 240 + 1)
    return CanFrame(T0 + 2 * MS * k + delay_ns, 0x1A1 + wheel, data)


def test_a_report_is_valid_at_the_sync_it_echoes() -> None:
    bus = source()
    samples = bus.feed(
        frame_array([sync(0), report(0), sync(1), report(0, 50.0, wheel=1, delay_ns=2 * MS + 1)])
    )
    assert samples.t_ns.tolist() == [T0 + 10_000] * 2
    assert samples.device.tolist() == [0, 1]
    assert samples.values[:, 0] == pytest.approx([100.0, 50.0], abs=1e-6)
    assert samples.values[:, 1] == pytest.approx([0.1, 0.1])


@pytest.mark.parametrize(
    "bad",
    [
        report(0, speed=701.0),
        report(0, status=0x01),
        report(0, status=0x19),
        report(0, status=0x49),
        report(5),
        CanFrame(T0 + 1, 0x1A1, b"\0" * 7),
        CanFrame(T0 + 1, 0x1A1, report(0).data + bytes(4), is_fd=True),
    ],
)
def test_a_bad_report_is_rejected_and_counted_and_the_next_one_is_used(bad: CanFrame) -> None:
    bus = source()
    assert len(bus.feed(frame_array([sync(0), bad]))) == 0
    assert bus.status()["wheel1"]["rejected"] == 1
    assert len(bus.feed(frame_array([sync(1), report(1)]))) == 1


def test_a_torque_that_is_out_of_range_or_not_measured_leaves_the_speed() -> None:
    frames = frame_array([sync(0), report(0, torque=0.5), sync(1), report(1, status=0x08)])
    samples = source().feed(frames)
    assert np.isnan(samples.values[:, 1]).tolist() == [True, True]
    assert samples.values[:, 0] == pytest.approx([100.0, 100.0], abs=1e-6)
    mute = source(torque="none").feed(frame_array([sync(0), report(0)]))
    assert np.isnan(mute.values[:, 1]).all()


def test_the_same_report_twice_counts_once() -> None:
    bus = source()
    assert len(bus.feed(frame_array([sync(0), report(0), report(0, delay_ns=400_000)]))) == 1
    assert bus.status()["wheel1"]["rejected"] == 1


def test_a_silent_wheel_is_found_and_one_never_heard_is_not() -> None:
    bus = source()
    bus.feed(frame_array([sync(0), report(0)]))
    assert bus.findings() == []
    bus.feed(frame_array([sync(k) for k in range(1, 60)]))
    bus.watch(sync(59).t_ns, up=True)
    (found,) = bus.findings()
    assert (found.fault, found.subject) == (Fault.WHEEL_SILENT, "wheel1")


def test_only_frames_of_wheels_are_its_own() -> None:
    frames = frame_array(
        [sync(0), report(0), CanFrame(T0, 0x191, b"\0" * 8), CanFrame(T0, 0x2A2, b"\xfa\0")]
    )
    bus = source()
    assert bus.owns(frames).tolist() == [False, True, False, True]
    bus.feed(frames)
    assert bus.status()["wheel2"]["temperature_degc"] == pytest.approx(25.0)


def test_a_batch_without_a_report_does_not_disturb_the_next_one() -> None:
    bus = source()
    bus.feed(frame_array([sync(0), report(0)]))
    bus.feed(frame_array([sync(k) for k in range(1, 21)]))
    samples = bus.feed(frame_array([sync(21), report(21), sync(22), report(22, wheel=1)]))
    assert samples.t_ns.tolist() == [T0 + 2 * MS * k + 10_000 for k in (21, 22)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axis_B": (0.0, 0.0, 2.0)}, "length 1"),
        ({"rate_hz": 0.5}, "at least 1"),
        ({"torque_noise_nm": None}, "torque_noise_nm: missing"),
        ({"inertia_kg_m2": 0.0}, "inertia_kg_m2"),
    ],
)
def test_wrong_configurations_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        wheel_config(**change)
