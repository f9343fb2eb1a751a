"""One lie in one flight: the samples of a clean flight, changed, then conditioned and estimated.

The clean flight of the same seed is the lie's twin: its sigma says what harm is, whatever the
estimator makes of the lie.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from evidence.effects.samples import exact, noisy, rate_hz
from evidence.lies import DEFAULT
from evidence.lies.table import Lie, drawn
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import Channels, condition
from evidence.mistakes.run import leave_to_the_defaults
from evidence.provenance import DEVELOPMENT, fresh_seed
from fsw.config import Config, load
from fsw.estimators.recursive.online import build_online
from fsw.messages import Estimate
from hil.judge.outcome import CONFIDENT, body_report, body_sigma, worst
from hil.world import scenario
from hil.world.inertia import FloatArray

FLIGHTS = 2  # clean flights of each scenario and doubt
REFUSED = ("MODEL_MISMATCH", "REOPENED", "NOT_CONSISTENT")  # false alarms of a clean flight
STREAM = 151  # spawn key of the lies


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Case:
    """A lie by sensor, kind and level of size; `draw` fixes everything that is random."""

    scenario: str
    doubts: str
    flight: int  # one of FLIGHTS
    sensor: str
    kind: str
    level: int
    draw: str  # a commit's hash, or a seed of development

    def __str__(self) -> str:
        """Return the key in the store."""
        return f"{self.doubts} {self.sensor} {self.kind} {self.level}"

    @property
    def seed(self) -> int:
        """Return the seed of the flight."""
        if self.draw.isdecimal() and int(self.draw) < DEVELOPMENT:
            return int(self.draw) + self.flight
        return fresh_seed(self.draw, self.scenario, self.flight)

    @property
    def lie(self) -> Lie:
        """Return the lie."""
        own = int.from_bytes(hashlib.sha256(f"{self.draw} {self}".encode()).digest()[:4], "big")
        rng = np.random.default_rng(np.random.SeedSequence(own, spawn_key=(STREAM,)))
        return drawn(self.sensor, self.kind, self.level, rng)


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Readings of a clean flight, its configuration, and the estimates that they give."""

    config: Config
    clean: Channels
    estimates: list[Estimate]
    folder: TemporaryDirectory[str]  # of the robot's file; it lives as long as the flight


def work(case: Case) -> dict[str, dict[str, Any]]:
    """Return the row of a lie under its key."""
    flight = flight_of(case.scenario, case.doubts, case.seed)
    lying = case.lie.on(flight.clean)
    found = estimates_of(flight.config, lying, rate_hz(scenario.load(case.scenario)))
    own = {"scenario": case.scenario, "doubts": case.doubts, "seed": case.seed}
    words = {"sensor": case.sensor, "kind": case.kind, "level": case.level, "lie": str(case.lie)}
    truth = scenario.load(case.scenario).truth
    return {str(case): own | words | judged(found, flight.estimates, truth)}


def judged(
    found: list[Estimate], twin: list[Estimate], truth: dict[str, FloatArray]
) -> dict[str, Any]:
    """Return counts of the published estimates of a lie, beside those of its clean twin.

    An output is `wrong` if it is valid and beyond CONFIDENT of its own sigmas. A lie is `harmful`
    if it moves an estimate beyond as many sigmas of the twin while that is valid. `lost` counts the
    outputs that are not valid though the twin's are.
    """
    own = {one.t_ns: one for one in twin}
    pairs = [(one, own[one.t_ns]) for one in found if one.t_ns in own and own[one.t_ns].valid]
    errors = [worst(one.bodies, truth) for one in found if one.valid]
    harm = [_against(one, other, truth) for one, other in pairs]
    return {
        "valid": len(errors),
        "wrong": sum(error > CONFIDENT for error in errors),
        "worst": max(errors, default=0.0),
        "harm": max(harm, default=0.0),
        "harmful": any(size > CONFIDENT for size in harm),
        "lost": sum(not one.valid for one, _ in pairs),
        "pairs": len(pairs),
        "twin_valid": sum(one.valid for one in twin),
        "twin_lost": sum(not one.valid for one in _later(twin)),
        "twin_wrong": sum(one.valid and worst(one.bodies, truth) > CONFIDENT for one in twin),
        "reasons": sorted({one.reason for one, _ in pairs if not one.valid}),
        "twin_refused": sum(one.reason in REFUSED for one in _later(twin)),
    }


def _later(estimates: list[Estimate]) -> list[Estimate]:
    """Return the outputs from the first valid one on."""
    first = next((k for k, one in enumerate(estimates) if one.valid), len(estimates))
    return estimates[first:]


def _against(one: Estimate, twin: Estimate, truth: dict[str, FloatArray]) -> float:
    """Return the largest |error| of an estimate over the sigma of its twin."""
    return max(
        float(np.max(np.abs(body_report(body) - truth[name]) / body_sigma(twin.bodies[name])))
        for name, body in one.bodies.items()
    )


@lru_cache(maxsize=2)
def flight_of(name: str, doubts: str, seed: int) -> Flight:
    """Return a clean flight of a scenario."""
    place = TemporaryDirectory(prefix="lies-")
    folder, own = Path(place.name), scenario.load(name)
    config = write_config(own, seed, folder)
    clean = noisy(exact(name, config), config, seed)
    if doubts == DEFAULT:
        document = yaml.safe_load((folder / "flight.yaml").read_text(encoding="utf-8"))
        leave_to_the_defaults(document)
        (folder / "doubted.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
        config = load(folder / "doubted.yaml")
    return Flight(config, clean, estimates_of(config, clean, rate_hz(own)), place)


def estimates_of(config: Config, readings: Channels, at_hz: float) -> list[Estimate]:
    """Return every estimate that the flight software publishes from the readings."""
    online = build_online(config)
    return [online.push(block) for block in condition(readings, config, at_hz)]
