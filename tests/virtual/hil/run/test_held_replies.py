"""Drives timed by SYNC on a machine that holds their replies for periods, and loses some."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.devices.can_segment import TimedFrame
from hil.judge import judgement
from hil.links.virtual import VirtualBench
from hil.run import bench
from tests.support.short_cases import NoMeter, short

RATE_HZ = 100.0
TOP_999 = 29.6  # of a chi-squared value with 10 degrees of freedom
MS = 1_000_000
STALLS_HZ = 3.0
HELD_MS = 4, 45  # most stalls end behind the next SYNC, some behind the fourth one
LOSS = 0.01  # of frames, two of which make a sample
GAP_NS = 150_000  # between two frames on the wire


class BusyMachine:
    """Delivers frames in order; in a stall none, and behind it all of them at once."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._stall_ns = self._free_ns = self._last_ns = 0
        self.late = self.lost = 0

    def tap(self, frames: Sequence[TimedFrame]) -> list[TimedFrame]:
        """Return the frames as they are delivered."""
        return [held for frame in frames for held in self._deliver(frame)]

    def _deliver(self, frame: TimedFrame) -> list[TimedFrame]:
        t_ns = frame[0]
        self._stall_ns = self._stall_ns or t_ns
        while self._stall_ns <= t_ns:
            length_ns = int(self._rng.integers(*HELD_MS) * MS)
            self._free_ns = max(self._free_ns, self._stall_ns + length_ns)
            self._stall_ns += round(self._rng.exponential(1e9 / STALLS_HZ))
        if self._rng.random() < LOSS:
            self.lost += 1
            return []
        self._last_ns = max(t_ns, self._free_ns, self._last_ns + GAP_NS)
        self.late += self._last_ns - t_ns > 1e9 / RATE_HZ
        return [(self._last_ns, *frame[1:])]


def test_replies_held_for_periods_and_lost_ones_lose_no_flight(tmp_path):
    scenario = short(tmp_path, points=8, rate_hz=RATE_HZ)
    joints = scenario.sensors["joints"] | {"dialect": "cia402"}
    scenario = replace(scenario, sensors=scenario.sensors | {"joints": joints})
    setup = bench.prepare(scenario, 1, tmp_path)
    machine = BusyMachine(7)

    def disturb(world: VirtualBench) -> None:
        world.can.tap = machine.tap

    recorded = bench.run_virtual(setup, NoMeter(), record=False, disturb=disturb)
    outcome: dict[str, Any] = judgement.judge(setup, judgement.make_case(setup), recorded)
    counts = recorded.status["samples"][setup.config.buses[0].name]
    expected = RATE_HZ * setup.total_s * len(setup.config.joints)
    assert machine.late > 0.02 * 2 * expected
    assert machine.lost > 0.005 * 2 * expected
    assert counts["reject_stale"] > 0.02 * expected
    assert counts["reject_sequence"] == 0
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < TOP_999
