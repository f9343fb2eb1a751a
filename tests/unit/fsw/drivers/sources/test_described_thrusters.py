"""Thrusters of other makers: frames are encoded here by struct."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fsw.config import Config
from fsw.config.thrusters import ThrusterConfig
from fsw.drivers.sources.devices import other_sources
from fsw.drivers.sources.thrusters import ThrusterBusSource
from fsw.drivers.wire import CanFrame, frame_array
from tests.support.driver_configs import bus_config
from tests.support.thruster_cases import thruster_settings

MS = 1_000_000
T0 = 10**12
PERIOD_NS = 20 * MS
TICK_S = 1e-4
# states of two valves, the age of the newest change of each, for how long each has been open
MESSAGES = [
    {
        "name": "valves",
        "id": 0x350,
        "length": 1,
        "signals": [{"name": f"open{k}", "start": k, "bits": 1} for k in range(2)],
    },
    *(
        {
            "name": name,
            "id": 0x351 + at,
            "length": 4,
            "signals": [
                {"name": f"{name}{k}", "start": 16 * k, "bits": 16, "scale": 0.1, "unit": "ms"}
                | ({"invalid": 0xFFFF} if name == "age" else {})
                for k in range(2)
            ],
        }
        for at, name in enumerate(("age", "total"))
    ),
]


def thruster(k: int, role: str, **changes: Any) -> dict[str, Any]:
    signals = {"valve": {"message": "valves", "signal": f"open{k}"}}
    signals[role] = {"message": "age" if role == "age" else "total", "signal": ""}
    signals[role]["signal"] = f"{signals[role]['message']}{k}"
    own = {"driver": "described", "node_id": None, "signals": signals}
    return thruster_settings(k, **(own | {"timing": {"by": "last_sync"}} | changes))


def made(tmp_path: Path, role: str) -> ThrusterBusSource:
    own = bus_config(rate_hz=50.0, sync_counter_max=0, messages=MESSAGES)
    configs = tuple(ThrusterConfig.model_validate(thruster(k, role)) for k in range(2))
    config = Config.model_construct(buses=(own,), thrusters=configs).read_from(b"", tmp_path, "c")
    (source,) = other_sources(config, own)
    assert isinstance(source, ThrusterBusSource)
    return source


def frames(
    firings: list[list[tuple[float, float]]], count: int, lost: tuple[int, ...] = ()
) -> list[CanFrame]:
    """Return the reports of two valves that open and close at certain times [s]."""
    sent = []
    for i in range(count):
        t_ns = T0 + PERIOD_NS * i
        t_s = (t_ns - T0) * 1e-9
        states, ages, totals = 0, [], []
        for k, own in enumerate(firings):
            past = [edge for pair in own for edge in pair if edge <= t_s]
            states |= (len(past) % 2) << k
            ages.append(min(0xFFFE, round((t_s - past[-1]) / TICK_S)) if past else 0xFFFF)
            open_s = sum(min(off, t_s) - on for on, off in own if on <= t_s)
            totals.append((round(open_s / TICK_S) + 65_000) % 65_536)  # it wraps
        sent.append(CanFrame(t_ns, 0x80, b""))
        if i not in lost:
            sent += [
                CanFrame(t_ns + 300_000, 0x350, bytes([states])),
                CanFrame(t_ns + 400_000, 0x351, struct.pack("<HH", *ages)),
                CanFrame(t_ns + 500_000, 0x352, struct.pack("<HH", *totals)),
            ]
    return sent


def edges(samples: Any, k: int) -> list[tuple[float, float]]:
    rows = (samples.device == k) & (samples.values[:, 1] == 1.0)
    return [
        ((t_ns - T0) * 1e-9, state)
        for t_ns, state in zip(samples.t_ns[rows], samples.values[rows, 0], strict=True)
    ]


@pytest.mark.parametrize("role", ["age", "on_time"])
def test_changes_have_their_own_times(tmp_path, role):
    firings = [[(0.0312, 0.1173), (0.1602, 0.2001)], [(0.0551, 0.3007)]]
    source = made(tmp_path, role)
    samples = source.feed(frame_array(frames(firings, 20, lost=(4,))))
    assert not np.isnan(samples.values).any()
    for k, own in enumerate(firings):
        expected = [(t_s, state) for pair in own for t_s, state in zip(pair, (1, 0), strict=True)]
        np.testing.assert_allclose(edges(samples, k), expected, atol=1.01 * TICK_S)
    status = source.status()
    assert (status["thruster1"]["accepted"], status["thruster1"]["open"]) == (19, 0.0)


@pytest.mark.parametrize("role", ["age", "on_time"])
def test_a_pulse_between_two_reports_is_unknown(tmp_path, role):
    samples = made(tmp_path, role).feed(frame_array(frames([[(0.105, 0.113)], []], 10)))
    marked = np.isnan(samples.values[:, 0])
    assert samples.device[marked].tolist() == [0]
    assert samples.t_ns[marked].tolist() == [T0 + 6 * PERIOD_NS]
    assert not edges(samples, 0)


def test_a_time_open_that_is_not_told_leaves_a_gap(tmp_path):
    """Its frame is lost: what happened since the report before, and until the next, is unknown."""
    sent = frames([[(0.0312, 0.1173)], []], 20)
    lost_ns = T0 + 4 * PERIOD_NS + 500_000
    samples = made(tmp_path, "on_time").feed(frame_array([f for f in sent if f.t_ns != lost_ns]))
    for k in range(2):
        marked = np.isnan(samples.values[:, 0]) & (samples.device == k)
        assert samples.t_ns[marked].tolist() == [T0 + PERIOD_NS * i for i in (4, 5)]
    np.testing.assert_allclose(edges(samples, 0), [(0.0312, 1), (0.1173, 0)], atol=1.01 * TICK_S)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"signals": {"valve": {"message": "valves", "signal": "open0"}}}, "signals.age: missing"),
        ({"node_id": 3}, "node_id: 3 must be left out with driver: described"),
        ({"driver": "canopen", "signals": None, "timing": None}, "node_id: missing with driver"),
    ],
)
def test_keys_that_do_not_go_together(changes, words):
    with pytest.raises(ValidationError, match=words):
        ThrusterConfig.model_validate(thruster(0, "age", **changes))
