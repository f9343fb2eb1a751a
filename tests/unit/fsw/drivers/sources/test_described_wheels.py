"""Wheels of other makers: frames are encoded here by struct."""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fsw.config import Config
from fsw.config.wheels import WheelConfig
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.sources.wheels import WheelBusSource
from fsw.drivers.wire import CanFrame, frame_array
from fsw.errors import ConfigError
from tests.support.driver_configs import bus_config
from tests.support.own_wires import EDS
from tests.support.wheel_cases import wheel_settings

MS = 1_000_000
T0 = 10**12
RATE_HZ = 20.0
PERIOD_NS = 50 * MS
MESSAGES = [
    {
        "name": f"wheel{k}",
        "id": 0x310 + k,
        "length": 6,
        "signals": [
            {"name": "speed", "start": 7, "bits": 16, "order": "big", "number": "signed"}
            | {"scale": 0.5, "unit": "rpm"},
            {"name": "torque", "start": 16, "bits": 16, "number": "signed", "unit": "mN m"},
            {"name": "flags", "start": 32, "bits": 8},
        ],
    }
    for k in range(2)
]


def signals(k: int, *, torque: bool = False) -> dict[str, Any]:
    own = {"speed": {"message": f"wheel{k}", "signal": "speed"}}
    own["status"] = {"message": f"wheel{k}", "signal": "flags", "mask": 3, "value": 1}
    return own | ({"torque": {"message": f"wheel{k}", "signal": "torque"}} if torque else {})


def wheel(k: int, **changes: Any) -> dict[str, Any]:
    settings = wheel_settings(k, driver="described", node_id=None, rate_hz=RATE_HZ)
    return settings | {"signals": signals(k), "timing": {"by": "last_sync"}} | changes


def made(tmp_path: Path, wheels: list[dict[str, Any]], **bus: Any) -> WheelBusSource:
    own = bus_config(**({"rate_hz": RATE_HZ, "messages": MESSAGES} | bus))
    configs = tuple(WheelConfig.model_validate(one) for one in wheels)
    config = Config.model_construct(buses=(own,), wheels=configs).read_from(b"", tmp_path, "c")
    return WheelBusSource(own, list(enumerate(configs)), layouts_of(config, own, "wheels"))


def report(k: int, t_ns: int, speed: int, torque: int = 0, flags: int = 1) -> CanFrame:
    data = struct.pack(">h", speed) + struct.pack("<hBx", torque, flags)
    return CanFrame(t_ns, 0x310 + k, data)


def synced(k: int, speeds: list[int], **more: Any) -> list[CanFrame]:
    times = [T0 + PERIOD_NS * i for i in range(len(speeds))]
    return [
        frame
        for t_ns, speed in zip(times, speeds, strict=True)
        for frame in (CanFrame(t_ns, 0x80, b""), report(k, t_ns + 400_000, speed, **more))
    ]


def test_a_speed_is_as_old_as_its_sync_and_the_wheels_delay(tmp_path):
    source = made(tmp_path, [wheel(0, delay_s=2e-3)], sync_counter_max=0, latch_offset_s=1e-4)
    samples = source.feed(frame_array(synced(0, [1000, -2000, 32])))
    expected = np.array([500.0, -1000.0, 16.0]) * math.tau / 60
    np.testing.assert_allclose(samples.values[:, 0], expected, rtol=1e-12)
    np.testing.assert_array_equal(samples.t_ns, T0 + PERIOD_NS * np.arange(3) + 100_000 - 2 * MS)
    assert np.isnan(samples.values[:, 1]).all()
    assert source.status()["wheel1"]["accepted"] == 3


def test_two_wheels_by_arrival_with_torque(tmp_path):
    rng = np.random.default_rng(3)
    more = {"torque": "measured", "torque_noise_nm": 1e-3}
    timing = {"by": "arrival", "sigma_s": 1e-4}
    own = [wheel(k, signals=signals(k, torque=True), timing=timing, **more) for k in range(2)]
    source = made(tmp_path, own, sync="none", listen_only=True)
    true_ns = T0 + PERIOD_NS * np.arange(200)
    frames = [
        report(k, round(t_ns + 7 * MS * k + 95_000 + rng.exponential(1e5)), 100 * (k + 1), 250)
        for t_ns in true_ns.tolist()
        for k in range(2)
    ]
    samples = source.feed(frame_array(sorted(frames, key=lambda frame: frame.t_ns)))
    for k in range(2):
        mine = samples.device == k
        assert mine.sum() == 200
        late_ns = samples.t_ns[mine] - true_ns - 7 * MS * k
        assert np.abs(late_ns[100:]).max() < 5e4
        np.testing.assert_allclose(samples.values[mine, 1], 0.25)
    assert source.words == [0x310, 0x311]


@pytest.mark.parametrize(
    ("frames", "accepted"),
    [
        ([report(0, T0, 1)], 0),  # no SYNC before it
        (synced(0, [1], flags=2), 0),
        (synced(0, [30_000]), 0),  # out of range
        ([*synced(0, [1]), report(0, T0 + 500_000, 1)], 1),  # twice
        ([CanFrame(T0, 0x80, b""), CanFrame(T0 + MS, 0x310, bytes(5))], 0),  # short
    ],
)
def test_what_cannot_be_used_is_rejected(tmp_path, frames, accepted):
    source = made(tmp_path, [wheel(0)], sync_counter_max=0)
    assert len(source.feed(frame_array(frames)).t_ns) == accepted
    counts = source.status()["wheel1"]
    assert (counts["accepted"], counts["rejected"]) == (accepted, 1)


def test_a_silent_wheel_is_found(tmp_path):
    source = made(tmp_path, [wheel(0)], sync_counter_max=0)
    source.feed(frame_array(synced(0, [1])))
    source.watch(T0 + 6 * PERIOD_NS, up=True)
    (found,) = source.findings()
    assert (found.fault, found.subject) == ("WHEEL_SILENT", "wheel1")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bus": None}, "bus: missing with driver: described"),
        ({"node_id": 3}, "node_id: 3 must be left out with driver: described"),
        ({"timing": None}, "timing: missing with driver: described"),
        ({"signals": {"torque": signals(0, torque=True)["torque"]}}, "signals.speed: missing"),
        ({"signals": signals(0, torque=True)}, "signals.torque: has no use with torque none"),
        ({"driver": "canopen", "node_id": 3}, "must be left out with driver: canopen"),
    ],
)
def test_keys_that_do_not_go_together(changes, words):
    with pytest.raises(ValidationError, match=words):
        WheelConfig.model_validate(wheel(0, **changes))


def test_a_signal_that_is_not_described_is_named(tmp_path):
    wrong = {"speed": {"message": "wheel0", "signal": "rate"}}
    with pytest.raises(ConfigError, match=r"^wheels.0.signals.speed.signal: 'rate' is not in"):
        made(tmp_path, [wheel(0, signals=wrong)])


def test_a_wheel_by_an_eds_of_its_own_is_a_node_that_is_started(tmp_path):
    (tmp_path / "wheel.eds").write_text(EDS)
    own = {"speed": {"message": "TPDO1", "signal": "0x6064", "unit": "rpm"}}
    data = wheel(0, signals=own, description="wheel.eds", node_id=5)
    source = made(tmp_path, [data], sync_counter_max=0)
    frames = [CanFrame(T0, 0x80, b""), CanFrame(T0 + MS, 0x185, struct.pack("<Hih", 7, -90, 0))]
    samples = source.feed(frame_array(frames))
    np.testing.assert_allclose(samples.values[:, 0], [-90 * math.tau / 60])
    config = Config.model_construct(wheels=(WheelConfig.model_validate(data),))
    assert [node.node_id for node in config.can_nodes] == [5]


def test_the_status_of_a_wheel_by_an_eds_is_its_own(tmp_path):
    """Its bits are not those of a tailored node, nor is its second PDO a temperature."""
    (tmp_path / "wheel.eds").write_text(EDS)
    torque = {"unit": "permille", "rated_torque_nm": 0.1}
    own = {
        "speed": {"message": "TPDO1", "signal": "0x6064", "unit": "rpm"},
        "torque": {"message": "TPDO1", "signal": "0x6077"} | torque,
        "status": {"message": "TPDO1", "signal": "0x6041", "mask": 0x6F, "value": 0x27},
    }
    more = {"torque": "measured", "torque_noise_nm": 1e-3}
    data = wheel(0, signals=own, description="wheel.eds", node_id=5, **more)
    source = made(tmp_path, [data], sync_counter_max=0)
    report = struct.pack("<Hih", 0x1237, -90, 500)
    frames = [CanFrame(T0, 0x80, b""), CanFrame(T0 + MS, 0x185, report)]
    samples = source.feed(frame_array([*frames, CanFrame(T0 + 2 * MS, 0x285, bytes(2))]))
    np.testing.assert_allclose(samples.values, [[-90 * math.tau / 60, 0.05]])
    assert "temperature_degc" not in source.status()["wheel1"]
