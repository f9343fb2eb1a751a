"""One clean flight, from samples or from bytes, and which checks failed it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from evidence import seeds
from evidence.effects.samples import exact, noisy, rate_hz
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import condition
from evidence.provenance import fresh_seed
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.recursive.online import build_online
from fsw.estimators.recursive.outside import CODES
from fsw.messages import Estimate
from hil.judge.outcome import outputs
from hil.world.scenario import load

SAMPLES, BYTES = "samples", "bytes"
EVENTS: Mapping[str, tuple[str, ...]] = {
    "change": ("CHANGE_DETECTED",),
    "outside": tuple(CODES.values()),
    "prior": ("PRIOR_CONFLICT",),
    "level": ("NOISE_ABOVE_DECLARED",),
    "creep": ("SENSOR_CREEPS",),
    "reset": ("ESTIMATOR_RESET",),
}


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """A flight of a scenario by its number; the commit fixes the seed."""

    level: str
    scenario: str
    number: int
    commit: str

    def __str__(self) -> str:
        """Return the key in the store."""
        return f"{self.level} {self.scenario} {self.number}"

    @property
    def seed(self) -> int:
        """Return a seed that nobody could choose: it follows from the commit's hash."""
        return fresh_seed(self.commit, self)


def work(case: Case) -> dict[str, dict[str, Any]]:
    """Return the row of a flight under its key."""
    row = _from_samples(case) if case.level == SAMPLES else _from_bytes(case)
    return {str(case): row | {"scenario": case.scenario, "level": case.level, "seed": case.seed}}


def _from_samples(case: Case) -> dict[str, Any]:
    scenario = load(case.scenario)
    with TemporaryDirectory(prefix="alarms-") as folder:
        config = write_config(scenario, case.seed, Path(folder))
        samples = noisy(exact(case.scenario, config), config, case.seed)
        blocks = condition(samples, config, rate_hz(scenario))
        model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
        online = build_online(config, model)
    published = [online.push(block) for block in blocks]
    published.append(online.finish())
    codes = [code for _, code, _ in online.events()]
    final = published[-1]
    return {
        "valid": final.valid,
        "reason": final.reason,
        "wrong": outputs(published, scenario.truth)["wrong"],
        "fired": by_event(codes) | by_estimate(published, len(online.findings())),
    }


def _from_bytes(case: Case) -> dict[str, Any]:
    (found,) = seeds.outcome(case.seed, case.scenario, ["--fast"]).values()
    codes = [code for code, count in found["events"].items() for _ in range(count)]
    return {
        "valid": found["valid"],
        "reason": found["reason"],
        "wrong": found["outputs"]["wrong"],
        "fired": by_event(codes)
        | {"gate": found["gated"], "sample": found["windows"]["outliers"]}
        | {"pace": codes.count("SYNC_CREEPS")}
        | {"mismatch": int(found["reason"] == "MODEL_MISMATCH")},
    }


def by_event(codes: Sequence[str]) -> dict[str, int]:
    """Return how often each check that has an event of its own has fired."""
    return {check: sum(codes.count(code) for code in own) for check, own in EVENTS.items()}


def by_estimate(published: Sequence[Estimate], findings: int) -> dict[str, int]:
    """Return how often the other checks of the recursion have fired.

    A reason counts from the first valid output on: before, there is no estimate to refuse.
    """
    first = next((k for k, one in enumerate(published) if one.valid), len(published))
    reasons = [one.reason for one in published[first:]]
    return {
        "gate": published[-1].gated,
        "sensor": findings,
        "mismatch": reasons.count("MODEL_MISMATCH"),
        "consistency": reasons.count("NOT_CONSISTENT"),
    }
