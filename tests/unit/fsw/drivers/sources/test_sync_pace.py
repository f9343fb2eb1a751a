"""Stamps of SYNC that creep are found; what an honest clock, bus or machine does is no creep."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from fsw.drivers.sources.sync_pace import STEPS, SyncPace, steadiness
from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages.findings import Fault
from tests.unit.fsw.drivers.sources import test_thrusters, test_wheels
from tests.unit.fsw.drivers.sources.test_described import made as described_joints
from tests.unit.fsw.drivers.sources.test_described import use
from tests.unit.fsw.drivers.sources.test_joints import cycle, source

RATE_HZ, PERIOD_NS, BEGINS_S = 500.0, 2_000_000, 15.0
T0_NS = 5_000_000_000
ANSWER_NS = 250_000.0
Course = Callable[[np.ndarray], np.ndarray]  # seconds to nanoseconds
Traffic = tuple[np.ndarray, np.ndarray]  # stamps of SYNC, stamps of the first answers


def traffic(
    seconds: float, rng: np.random.Generator, *, sent: Course | None = None, busy: float = 0.0
) -> Traffic:
    """Return true stamps. `sent`: how late SYNC is sent; `busy`: share of seconds in which a
    machine is, whose delays are then five times as long, and a stall of 3 s among them."""
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    seconds_busy = rng.random(int(seconds) + 1) < busy
    scale = np.where(seconds_busy[t_s.astype(int)], 5.0, 1.0)
    sync_ns = T0_NS + 1e9 * t_s + rng.exponential(40e3, len(t_s)) * scale
    sync_ns += 0.0 if sent is None else sent(t_s)
    sync_ns += 3e9 * (t_s > 20.0) * (busy > 0.0)
    return sync_ns, sync_ns + ANSWER_NS * scale**0.5 + rng.exponential(40e3, len(t_s)) * scale


def ramp(per_s: float, until_s: float = np.inf) -> Course:
    return lambda t_s: 1e9 * per_s * (np.clip(t_s, BEGINS_S, until_s) - BEGINS_S)


def flags(made: Traffic, batch: int = 500, *, own: bool = True) -> np.ndarray:
    """Return whether each SYNC is refused."""
    pace, found = SyncPace(RATE_HZ, own=own), []
    sync_ns, t_ns = (np.rint(part).astype(np.int64) for part in made)
    for start in range(0, len(sync_ns), batch):
        index = np.arange(start, min(start + batch, len(sync_ns)))
        pace.follow(index, index, sync_ns[index], t_ns[index])
        found.append(pace.crept(index))
    return np.concatenate(found)


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("per_s", [50e-6, -50e-6, 500e-6])
def test_stamps_that_leave_their_answers_are_refused_until_they_are_back(
    per_s: float, own: bool
) -> None:
    sync_ns, t_ns = traffic(60.0, np.random.default_rng(1))
    t_s = np.arange(len(sync_ns)) / RATE_HZ
    found = flags((sync_ns + ramp(per_s)(t_s) * (t_s < 40.0), t_ns), own=own)
    first_s = np.flatnonzero(found)[0] / RATE_HZ
    assert BEGINS_S + 1.0 < first_s < BEGINS_S + max(2.0, 400e-6 / abs(per_s)), first_s
    assert found[round(first_s * RATE_HZ) : round(40.0 * RATE_HZ)].all()
    assert not found[round(40.3 * RATE_HZ) :].any()


def test_stamps_of_a_whole_bus_that_leave_our_own_grid_are_refused() -> None:
    """Where SYNC and its answers creep alike, only the sender's own clock shows it."""
    made = traffic(40.0, np.random.default_rng(2), sent=ramp(50e-6))
    first_s = np.flatnonzero(flags(made))[0] / RATE_HZ
    assert BEGINS_S < first_s < BEGINS_S + 10.0
    assert not flags(made, own=False).any(), "the crystal of another sender may change"


HONEST: dict[str, Callable[[np.random.Generator], Traffic]] = {
    "clean": lambda rng: traffic(60.0, rng),
    "busy": lambda rng: traffic(60.0, rng, busy=0.4),
    "100 ppm off": lambda rng: traffic(60.0, rng, sent=lambda t_s: 1e5 * t_s),
    "100 ppm off, busy": lambda rng: traffic(60.0, rng, sent=lambda t_s: 1e5 * t_s, busy=0.4),
    "2 ppm off": lambda rng: traffic(60.0, rng, sent=lambda t_s: 2e3 * t_s),
    "ticks missed": lambda rng: traffic(60.0, rng, sent=lambda t_s: 2e6 * np.floor(t_s / 0.7)),
    "a suspend": lambda rng: traffic(60.0, rng, sent=lambda t_s: 3.6e12 * (t_s > 30.0)),
    "another phase": lambda rng: traffic(60.0, rng, sent=lambda t_s: 7e5 * (t_s > 30.0)),
}


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("kind", HONEST)
def test_an_honest_bus_is_in_pace(kind: str, own: bool) -> None:
    for seed in range(4):
        assert not flags(HONEST[kind](np.random.default_rng(seed)), own=own).any(), seed


@pytest.mark.parametrize("own", [True, False])
def test_delays_that_step_walk_or_are_read_by_ticks_are_no_creep(own: bool) -> None:
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        sync_ns, t_ns = traffic(60.0, rng)
        t_s = np.arange(len(sync_ns)) / RATE_HZ
        walk = 1e5 * np.cumsum(rng.standard_normal(61))[t_s.astype(int)]
        read_ns = T0_NS + np.ceil((t_ns - T0_NS) / PERIOD_NS) * PERIOD_NS
        slides = 160e3 * (t_s * 50e-6 / 160e-6 % 1.0)  # a frame of another crystal
        for late_ns in (5e5 * (t_s > 30.0), np.maximum(walk + 1e6, 0.0), slides):
            assert not flags((sync_ns, t_ns + late_ns), own=own).any(), seed
        assert not flags((sync_ns, read_ns), own=own).any(), seed


def test_another_sender_takes_over() -> None:
    """Its crystal, its phase and its nodes' delay are other ones."""
    rng = np.random.default_rng(5)
    first, second = (traffic(30.0, rng, sent=lambda t_s, ppm=p: 1e3 * ppm * t_s) for p in (80, -90))
    made = [np.concatenate([a, b + 30.3e9 + 4e5]) for a, b in zip(first, second, strict=True)]
    made[1][len(first[0]) :] += 2e5
    assert not flags((made[0], made[1]), own=False).any()


@pytest.mark.parametrize("span", [1, 2, 8, 32])
@pytest.mark.parametrize("kind", ["walk", "scatter"])
def test_a_delay_that_walks_is_called_steady_no_more_often_than_stated(
    span: int, kind: str
) -> None:
    rng, chance, count = np.random.default_rng(span), 1e-2, 5_000
    levels = rng.standard_normal((count, (STEPS + 1) * span))
    levels = np.cumsum(levels, axis=1) if kind == "walk" else levels
    means = levels.reshape(count, STEPS + 1, span).mean(axis=2)
    limit = stats.t.isf(0.5 * chance, STEPS - 1)
    alarms = np.mean([steadiness(own) > limit for own in means])
    assert alarms <= chance + 4.0 * np.sqrt(chance / count)


def test_nothing_depends_on_where_a_batch_ends() -> None:
    sync_ns, t_ns = traffic(40.0, np.random.default_rng(3))
    made = sync_ns + ramp(50e-6)(np.arange(len(sync_ns)) / RATE_HZ), t_ns
    every = [flags(made, batch) for batch in (17, 500, len(sync_ns))]
    assert every[0].any()
    for found in every[1:]:
        assert np.array_equal(found, every[0])


def crept(frame: CanFrame, k: int) -> CanFrame:
    return replace(frame, t_ns=frame.t_ns + round(ramp(50e-6)(np.array(k / RATE_HZ)).item()))


def test_joints_wheels_and_thrusters_of_the_bus_are_refused_counted_and_reported() -> None:
    joints, wheels, thrusters = source(), test_wheels.source(), test_thrusters.source()
    last: dict[str, int] = {}
    found = {"joints": [], "wheels": [], "thrusters": []}
    for start in range(0, 12_500, 100):
        made: dict[str, list[CanFrame]] = {name: [] for name in found}
        for k in range(start, start + 100):
            sync, *answers = cycle(k)
            made["joints"] += [crept(sync, k), *answers]
            wheels_sent = [test_wheels.report(k, wheel=own) for own in range(2)]
            made["wheels"] += [crept(sync, k), *wheels_sent]
            made["thrusters"] += [crept(sync, k), test_thrusters.report(k, 0, 0xFFFF, 0)]
        samples = joints.feed(made["joints"])
        last["joints"] = max([last.get("joints", 0), *(one.t_ns for one in samples)])
        for name, bus in (("wheels", wheels), ("thrusters", thrusters)):
            t_ns = bus.feed(frame_array(made[name])).t_ns
            last[name] = max([last.get(name, 0), *t_ns.tolist()])
        for name, bus in (("joints", joints), ("wheels", wheels), ("thrusters", thrusters)):
            found[name] += bus.findings()
    assert max(last.values()) - min(last.values()) < 1e8, "all of them at one time"
    assert BEGINS_S < (last["joints"] - test_wheels.T0) * 1e-9 < BEGINS_S + 10.0
    for name, findings in found.items():
        assert {one.fault for one in findings} == {Fault.SYNC_CREEPS}, name
        assert {one.subject for one in findings} == {"arm"}
    assert "stamps of SYNC have moved by" in found["wheels"][-1].text
    assert joints.counters["reject_stale"] == len(found["joints"])


def test_described_joints_of_a_bus_whose_sync_creeps_report_the_bus(tmp_path: Path) -> None:
    numbers = {"number": "unsigned", "bits": 8}
    held = [{"name": "angle", "start": 0} | numbers, {"name": "count", "start": 8} | numbers]
    message = {"name": "joint", "id": 0x1A1, "length": 2, "signals": held}
    signals = {
        "position": use("joint", "angle", unit="rad"), "counter": use("joint", "count"),
    }  # fmt: skip
    joints = described_joints(
        tmp_path,
        {"messages": [message], "rate_hz": RATE_HZ, "sync": "producer", "sync_counter_max": 240},
        [{"torque": "none", "signals": signals, "timing": {"by": "echoed_counter"}}],
    )
    frames = []
    for k in range(12_500):
        sync = test_wheels.sync(k)
        answer = CanFrame(sync.t_ns + 300_000, 0x1A1, bytes([k // 50 % 2, k % 240 + 1]))
        frames += [crept(sync, k), answer]
    joints.feed(frame_array(frames))
    found = {(one.fault, one.subject) for one in joints.findings()}
    assert (Fault.SYNC_CREEPS, "arm") in found
    assert Fault.SYNC_CREEPS not in {fault for fault, subject in found if subject != "arm"}
