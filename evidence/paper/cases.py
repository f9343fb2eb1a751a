"""Cases of the study of the paper: systems, orbits, noise, disturbances, seeds."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import yaml

from evidence.methods.flight_side import without_biases
from evidence.methods.sensed import ChannelNoise
from hil.world.environment.config import EnvironmentSection
from hil.world.inertia import FloatArray, pi_of
from hil.world.noise import BandLimitedWhiteNoise
from hil.world.scenario import FOLDER, Scenario, load

PAPER_SEED = 23000
SYSTEMS = ("base", "target", "both")
METHODS = ("mrnea", "rda", "cm", "ce", "fused")
PAPER = "paper"
ALL, NONE = "all", "none"
PARTS: Mapping[str, tuple[str, ...]] = {
    ALL: ("gravity_gradient", "third_body", "atmosphere", "solar_pressure"),
    NONE: (),
    "gravity gradient": ("gravity_gradient",),
    "atmosphere": ("atmosphere",),
    "Sun and Moon": ("third_body",),
    "sunlight": ("solar_pressure",),
}
SCENARIOS: Mapping[tuple[str, str], str] = {
    ("leo", "base"): "base",
    ("leo", "target"): "target_leo",
    ("leo", "both"): "both",
    ("geo", "base"): "base",
    ("geo", "target"): "target_geo",
    ("geo", "both"): "target_geo",
}


def _paper_like(noise: BandLimitedWhiteNoise, rate_hz: float, *, shared: bool) -> ChannelNoise:
    sigma = noise.sigma(rate_hz)
    return ChannelNoise(
        position_rad=sigma,
        torque_nm=sigma,
        rate_rad_s=sigma,
        acceleration_m_s2=sigma,
        attitude_rad=sigma,
        shared=shared,
    )


NOISES = (PAPER, "one sequence", "averaged", "literal", "data sheet", "ideal")


def noise_of(name: str, rate_hz: float) -> ChannelNoise:
    """Return the noise with a name of NOISES for samples at a rate [Hz]."""
    block = BandLimitedWhiteNoise()
    if name in (PAPER, "one sequence"):
        return _paper_like(block, rate_hz, shared=name != PAPER)
    if name in ("averaged", "literal"):
        literal = replace(block, reading="literal")
        if name == "averaged":
            literal = replace(literal, decimation="average")
        return _paper_like(literal, rate_hz, shared=False)
    if name == "ideal":
        return ChannelNoise(
            position_rad=1e-9,
            torque_nm=1e-6,
            rate_rad_s=1e-9,
            acceleration_m_s2=1e-8,
            attitude_rad=1e-9,
        )
    root = rate_hz**0.5
    return ChannelNoise(  # common/sensors.yaml: 24 bits, 0.05 N m at 500 Hz, STIM300, Sagitta
        position_rad=1.1e-7,
        torque_nm=0.05 * (rate_hz / 500.0) ** 0.5,
        rate_rad_s=4.4e-5 * root,
        acceleration_m_s2=5.0e-4 * root,
        attitude_rad=4.8e-5,
    )


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class PaperUnit:
    """One motion and one draw of noise for several methods."""

    level: str  # sample, device or bias
    orbit: str
    system: str
    noise: str
    acting: str  # one of PARTS
    seed: int
    methods: tuple[str, ...] = METHODS

    @property
    def key(self) -> str:
        """The key of the unit's result in the store."""
        where = (self.level, self.orbit, self.system, self.noise, self.acting, str(self.seed))
        return "|".join((*where, ",".join(self.methods)))


@lru_cache(maxsize=32)
def scenario_of(orbit: str, system: str, acting: str) -> Scenario:
    """Return the scenario of a system in an orbit with the disturbances `acting` of PARTS."""
    scenario = load(SCENARIOS[orbit, system])
    unknown = ("base", "target") if system == "both" else (system,)
    parts = yaml.safe_load((FOLDER / "common" / f"{orbit}.yaml").read_text(encoding="utf-8"))
    wanted = {"orbit", *PARTS[acting]}
    environment: EnvironmentSection | None = None
    if acting != NONE:
        environment = EnvironmentSection.from_dict({k: v for k, v in parts.items() if k in wanted})
    return replace(scenario, unknown=unknown, environment=environment)


def exact_sensors(scenario: Scenario, estimator: Mapping[str, Any]) -> Scenario:
    """Return the scenario without offsets and biases, and with other estimator settings."""
    flight = dict(scenario.flight)
    flight["estimator"] = dict(flight["estimator"]) | dict(estimator)
    return replace(without_biases(scenario), flight=flight)


def truth_of(scenario: Scenario) -> FloatArray:
    """Return the true parameters pi of the b unknown bodies, stacked (10 b,)."""
    return np.concatenate([pi_of(scenario.truth[body]) for body in scenario.unknown])
