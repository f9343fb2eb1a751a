"""Described devices on a bus whose frames hold anything: no error, no warning, finite samples."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.config.thrusters import ThrusterConfig
from fsw.drivers.sources.devices import other_sources
from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages import DeviceSamples, ImuSamples
from tests.support.driver_configs import bus_config, imu_config, star_tracker_config
from tests.support.thruster_cases import thruster_settings

T0 = 10**12
WIDTHS = {"w": 3, "f": 3, "q": 4, "v": 1}  # doubles in a message, with one byte of status
MESSAGES = [
    {"name": name, "id": 0x10 + i, "length": 8 * n + 1}
    | {
        "signals": [
            *({"name": f"s{k}", "start": 64 * k, "bits": 64, "number": "float"} for k in range(n)),
            {"name": "state", "start": 64 * n, "bits": 8},
        ]
    }
    for i, (name, n) in enumerate(WIDTHS.items())
]
DOUBLES = [
    *(struct.pack("<d", value) for value in (0.0, 0.5, 1e308, -1e308, np.inf, 1e-320)),
    bytes.fromhex("010000000000f07f"),  # a signalling NaN
    b"\xff" * 8,
]


def use(name: str, k: int, unit: str | None = None) -> dict[str, Any]:
    return {"message": name, "signal": f"s{k}", "unit": unit}


def status(name: str) -> dict[str, Any]:
    return {"status": {"message": name, "signal": "state", "mask": 1, "value": 1}}


def frame(rng: np.random.Generator, t_ns: int) -> CanFrame:
    if rng.random() < 0.2:
        return CanFrame(t_ns, 0x80, b"")
    at = int(rng.integers(len(WIDTHS)))
    words = [
        DOUBLES[rng.integers(len(DOUBLES))] if rng.random() < 0.7 else rng.bytes(8)
        for _ in range(list(WIDTHS.values())[at])
    ]
    data = b"".join(words) + rng.bytes(1)
    length = int(rng.integers(len(data))) if rng.random() < 0.05 else len(data)
    return CanFrame(t_ns, 0x10 + at, data[:length], is_fd=True)


@pytest.mark.parametrize("by", ["arrival", "last_sync"])
def test_no_frame_stops_a_source(by):
    rng, own = np.random.default_rng(1), {"by": by, "sigma_s": 1e-4}
    bus = bus_config(rate_hz=200.0, fd=True, sync_counter_max=0, messages=MESSAGES)
    keys = {"driver": "described", "bus": "arm", "timing": own}
    rates = {f"rate_{axis}": use("w", k, "deg/s") for k, axis in enumerate("xyz")}
    forces = {f"force_{axis}": use("f", k, "g") for k, axis in enumerate("xyz")}
    imu = imu_config(**keys, port=None, rate_hz=200.0, signals=rates | forces | status("w"))
    q = {f"q_{name}": use("q", k) for k, name in enumerate("wxyz")}
    tracker = star_tracker_config(**keys, port=None, rate_hz=50.0, signals=q | status("q"))
    valve = {"valve": {"message": "v", "signal": "state"}, "age": use("v", 0, "s")}
    thruster = thruster_settings(0, **keys, node_id=None, signals=valve)
    total = {"message": "v", "signal": "state", "unit": "s", "invalid": 7}
    second = thruster_settings(
        1, **keys, node_id=None, signals={"valve": valve["valve"], "on_time": total}
    )
    config = Config.model_construct(
        buses=(bus,),
        imu=imu,
        star_tracker=tracker,
        thrusters=tuple(ThrusterConfig.model_validate(own) for own in (thruster, second)),
    )
    sources, t_ns = other_sources(config.read_from(b"", Path(), "c"), bus), T0
    counts = dict.fromkeys(range(len(sources)), 0)
    for _ in range(300):
        stamps = t_ns + np.cumsum(rng.integers(0, 5_000_000, int(rng.integers(40)) + 1))
        t_ns = int(stamps[-1]) + 10**13 * (rng.random() < 0.02)
        frames = frame_array([frame(rng, int(stamp)) for stamp in stamps])
        for k, source in enumerate(sources):
            samples = source.feed(frames)
            source.watch(t_ns, up=True)
            source.findings()
            counts[k] += len(samples)
            if isinstance(samples, ImuSamples):
                cluster = np.isfinite(samples.w_NS_S_rad_s)
                assert (cluster.all(axis=1) == cluster.any(axis=1)).all()
            elif isinstance(samples, DeviceSamples):
                assert (samples.t_ns > 0).all()
    assert counts[0] > 50
