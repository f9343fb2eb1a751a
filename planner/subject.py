"""The subject of a plan: the robot, the bodies to be identified and the prior knowledge of them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import (
    PARAMETERS,
    from_parameters,
    is_consistent,
    report_jacobian,
    to_parameters,
)
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from planner.chain import Geometry, geometry
from planner.criteria import Scale, prior_root
from planner.kernel import Kernel, build_kernel
from planner.noise import NoiseModel, noise_model

QUANTITIES = (
    "mass_kg",
    *(f"com_{axis}_m" for axis in "xyz"),
    *(f"inertia_{axes}_kg_m2" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
CONSISTENT_DRAWS = 1000  # tries per drawn body


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Subject:
    """Robot, unknown bodies, prior and noise, with the CasADi functions of one sample.

    Attributes
    ----------
    x : (p,) nominal parameters of the unknown bodies
    state_covariance : (all, all) prior covariance of the estimator's whole state
    prior_root : (s, s) root R of the prior information R^T R of the states in the solver's rows;
        `foreseen` includes all other states
    wide_root : the same root from the configured prior, also if an earlier result replaces it
    scale : Jacobian of the reported quantities, their prior sigmas and weights
    draws : (k, p) further members of the prior set; (0, p) when the spread is zero
    names : (p,) names of the reported quantities, `target.mass_kg` ...
    """

    config: Config
    model: RobotModel
    problem: Problem
    arm: Geometry
    noise: NoiseModel
    kernel: Kernel
    x: FloatArray
    state_covariance: FloatArray
    prior_root: FloatArray
    wide_root: FloatArray
    scale: Scale
    draws: FloatArray
    names: tuple[str, ...]


def build_subject(
    config: Config,
    *,
    after: Path | Mapping[str, Any] | None = None,
    weights: dict[str, float] | None = None,
    spread: float = 0.0,
    draws: int = 0,
    seed: int = 0,
) -> Subject:
    """Return the subject of a configuration.

    Parameters
    ----------
    after : an estimate (names, mean, covariance) that replaces the bodies' prior, or the path of a
        result of `fsw identify --json`
    weights : weights of reported quantities by name; a body's name sets all of its quantities
    spread : sigma of the drawn bodies in units of the prior sigma
    draws : number of drawn bodies

    Raises
    ------
    ConfigError if a name or a file is wrong, or motions cannot be planned for this robot.
    """
    others = [name for name in config.bodies if name not in ("base", "target")]
    if others:
        raise ConfigError(f"bodies.{others[0]}: motions are planned for base and target alone")
    if config.base.motion != "free":
        raise ConfigError(f"base.motion: {config.base.motion}; motions are planned for a free base")
    config = config.model_copy(update={"wrench_sensors": ()})  # plans use joints and base
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    locked = config.model_copy(update=dict.fromkeys(("modes", *config.actuators), ()))
    problem = build_problem(locked, model, exact=True)
    noise = noise_model(config, model)
    p = PARAMETERS * len(problem.unknown)
    x, covariance = problem.prior_mean[:p], problem.prior_covariance.copy()
    if after is not None:
        x, covariance[:p, :p] = posterior(after, problem)
    arm = geometry(model, config.robot.tool_frame)
    bodies = {
        name: to_parameters(b.mass_kg, np.array(b.com_m), np.array(b.inertia_kg_m2))
        for name, b in config.bodies.items()
    }
    kernel = build_kernel(
        arm,
        problem.unknown,
        bodies.get("base", model.pi_links[:PARAMETERS]),
        bodies.get("target"),
        noise,
    )
    names = tuple(f"{body}.{quantity}" for body in problem.unknown for quantity in QUANTITIES)
    T = np.zeros((p, p))
    for body in problem.unknown:
        k = problem.body(body)
        T[k, k] = report_jacobian(x[k])
    sigma = np.sqrt(np.diag(T @ covariance[:p, :p] @ T.T))
    scale = Scale(T=T, prior_sigma=sigma, weights=_weights(names, weights or {}))
    apart = (problem.at("wrench"), problem.at("target_wrench"), problem.delays.states)
    w = np.r_[(*apart, *(term.states for term in problem.torque_terms))]
    root, wide = (
        prior_root(np.delete(np.delete(known, w, 0), w, 1))
        for known in (covariance, problem.prior_covariance)
    )
    return Subject(
        config=config,
        model=model,
        problem=problem,
        arm=arm,
        noise=noise,
        kernel=kernel,
        x=x,
        state_covariance=covariance,
        prior_root=root,
        wide_root=wide,
        scale=scale,
        draws=_draw(problem, x, sigma, spread, draws if spread > 0 else 0, seed),
        names=names,
    )


def posterior(source: Path | Mapping[str, Any], problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return mean (p,) and covariance (p, p) of the unknown bodies from an estimate or its file.

    Biases of the estimate are ignored, because they belong to the data of that estimate.

    Raises
    ------
    ConfigError if it cannot be read or has no finite result for these bodies.
    """
    wanted = problem.names[problem.bodies]
    try:
        result = json.loads(source.read_text("utf-8")) if isinstance(source, Path) else source
        index = [list(result["names"]).index(name) for name in wanted]
        mean = np.array(result["mean"], dtype=np.float64)[index]
        covariance = np.array(result["covariance"], dtype=np.float64)[np.ix_(index, index)]
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise ValueError("a number is not finite")
    except OSError as error:
        raise ConfigError(f"{source}: cannot be read: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ConfigError(
            f"{source if isinstance(source, Path) else 'estimate'}: must be a result with names, "
            f"mean and covariance of {' and '.join(problem.unknown)} ({error})"
        ) from error
    return mean, covariance


def _weights(names: tuple[str, ...], chosen: dict[str, float]) -> FloatArray:
    weights = np.ones(len(names))
    for key in sorted(chosen, key=len):  # bodies first, so that their quantities override them
        hit = [name == key or name.startswith(f"{key}.") for name in names]
        if not any(hit):
            raise ConfigError(f"weight {key!r}: none of {', '.join(names)}")
        if not chosen[key] >= 0:
            raise ConfigError(f"weight {key!r}: {chosen[key]} must not be negative")
        weights[np.array(hit)] = chosen[key]
    if not weights.any():
        raise ConfigError("weights: all are zero")
    return weights


def _draw(
    problem: Problem, x: FloatArray, sigma: FloatArray, spread: float, count: int, seed: int
) -> FloatArray:
    """Return (count, p) physically consistent bodies drawn about x; x if no draw is consistent."""
    rng = np.random.default_rng(seed)
    drawn = np.tile(x, (count, 1))
    for row in drawn:
        for body in problem.unknown:
            k = problem.body(body)
            mass, com, inertia = from_parameters(x[k])
            report = np.concatenate(([mass], com, inertia))
            for _ in range(CONSISTENT_DRAWS):
                trial = report + spread * sigma[k] * rng.standard_normal(PARAMETERS)
                pi = to_parameters(float(trial[0]), trial[1:4], trial[4:])
                if is_consistent(pi):
                    row[k] = pi
                    break
    return drawn
