"""One seed of a rough world (friction, wrong links, coloured torque noise) or an ideal world.

The bench simulates the truth; the flight software's conditioner and recursion use its samples.
"""

import math
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of
from evidence.methods.exact import exact_samples
from evidence.methods.flight_side import write_config
from evidence.methods.recursion import recursion_row
from evidence.methods.sensed import condition, declared
from evidence.mistakes.run import leave_to_the_defaults, samples
from fsw.config import Config, load
from fsw.messages import Block
from hil.world.base_urdf import change_links, child_links
from hil.world.doubts import spread
from hil.world.friction import JointFriction
from hil.world.inertia import FloatArray
from hil.world.scenario import mapping_from, report_from

COULOMB_NM = (0.05, 0.5)  # smallest and largest Coulomb friction
VISCOUS_SIGMA_NMS_RAD = 0.3
LINKS_OFF = (0.01, 0.05)  # least and largest relative mass error of a link or a known base
FADING_S = 0.02  # time constant of the coloured torque noise
NOISE = replace(SENSOR_SETS["data sheet"], torque_nm=0.05)  # coloured noise does not average out
STREAM = 211
ROUGH = ("declared", "undeclared")
IDEAL = ("exact", "terms", "defaults")
WORLD = {**dict.fromkeys(ROUGH, "rough"), **dict.fromkeys(IDEAL, "ideal")}


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """One run; `told`, of ROUGH or IDEAL, is how the configuration describes the world."""

    unknown: str  # target, base, both
    told: str
    seed: int

    def __str__(self) -> str:
        """Return the key in the store."""
        return f"{self.unknown} {self.told} {self.seed}"


def work(case: Case) -> dict[str, dict[str, Any]]:
    """Return the row of a case under its key."""
    with tempfile.TemporaryDirectory(prefix="rough-") as name:
        config, blocks = made(case, Path(name))
        return {str(case): recursion_row(config, blocks, scenario_of(case.unknown).truth)[0]}


def made(case: Case, folder: Path, count: int | None = None) -> tuple[Config, list[Block]]:
    """Return the flight configuration and the first `count` blocks (None: all blocks)."""
    right = write_config(scenario_of(case.unknown), case.seed, folder)
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(STREAM,)))
    n = len(right.joints)
    coulomb, viscous = _sized(rng, *COULOMB_NM, n), rng.standard_normal(n)
    is_rough = WORLD[case.told] == "rough"
    fading = math.exp(-1.0 / (FADING_S * RATE_HZ)) if is_rough else 0.0
    raw = samples(case.unknown, right, case.seed, NOISE, fading)
    document = yaml.safe_load((folder / "flight.yaml").read_text(encoding="utf-8"))
    if is_rough:
        friction = JointFriction(
            coulomb_nm=coulomb,
            viscous_nms_rad=VISCOUS_SIGMA_NMS_RAD * viscous,
            speed_rad_s=0.01,
        )
        rubbed = friction.torque_nm(exact_samples(case.unknown).qd)
        raw = replace(raw, tau_nm=raw.tau_nm + rubbed)
        _drawn_wrong(document, folder / "robot.urdf", rng)
    if case.told == "defaults":
        leave_to_the_defaults(document)
    if case.told in ("declared", "terms"):
        document["robot"]["links_sigma_ratio"] = _rms(*LINKS_OFF)
        for joint in document["joints"]:
            joint["friction_coulomb_sigma_nm"] = _rms(*COULOMB_NM)
            joint["friction_viscous_sigma_nms_rad"] = VISCOUS_SIGMA_NMS_RAD
    path = folder / "told.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    config = declared(load(path), NOISE, RATE_HZ, window_s=WINDOW_S, nodes=NODES)
    return config, condition(raw, config, RATE_HZ)[:count]


def _drawn_wrong(document: dict[str, Any], urdf: Path, rng: np.random.Generator) -> None:
    """Make the links and a known base wrong in the robot file and the flight configuration."""
    text = urdf.read_text(encoding="utf-8")
    names = child_links(text)
    off, *others = _sized(rng, *LINKS_OFF, len(names) + 1)
    changes = {
        name: partial(drawn_body, mass_off=mass_off, rng=rng)
        for name, mass_off in zip(names, others, strict=True)
    }
    urdf.write_text(change_links(text, changes), encoding="utf-8")
    if "base" not in document["unknown"]:
        base = report_from(document["bodies"]["base"])
        document["bodies"]["base"] |= mapping_from(drawn_body(base, off, rng))


def drawn_body(report: FloatArray, mass_off: float, rng: np.random.Generator) -> FloatArray:
    """Return the report of a wrong body, whose errors are those that `links_sigma_ratio` declares.

    The S of `spread` is Gaussian; only S[0, 0] is given: the relative error `mass_off` of the mass.
    """
    S = _rms(*LINKS_OFF) * rng.standard_normal((4, 4)) / math.sqrt(2.0)
    S = (S + S.T) / math.sqrt(2.0)
    S[0, 0] = mass_off
    return spread(report, S)


def _sized(rng: np.random.Generator, least: float, most: float, count: int) -> FloatArray:
    """Return values with a random sign and a magnitude that is uniform between two bounds."""
    return np.asarray(rng.uniform(least, most, count) * rng.choice([-1.0, 1.0], count))


def _rms(least: float, most: float) -> float:
    """Return the root mean square of the values that `_sized` draws."""
    return math.sqrt((most**3 - least**3) / (3.0 * (most - least)))
