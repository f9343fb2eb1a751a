"""The sought bodies over time: centre of mass, its ellipsoid, and the truth where it is known."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.estimators.model.inertia import NAMES, report_jacobian, to_parameters
from fsw.messages import BodyEstimate, Estimate, FloatArray
from fsw.messages.errors import ConfigError

SIGMAS = 3.0
LEAST_SEEN = 0.1  # longest semi-axis over the robot's reach; a smaller ellipsoid is magnified


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guess:
    """Estimate of a body's mass and centre of mass, valid from a time on; in the body's frame."""

    t_s: float
    body: BodyEstimate
    covariance_m2: FloatArray  # (3, 3) of the centre of mass
    reason: str = ""  # why not valid; empty when valid


def guesses(estimates: Sequence[Estimate], name: str, start_ns: int) -> list[Guess]:
    """Return the estimates of a body."""
    found = []
    for e in estimates:
        places = [e.names.index(f"{name}.{quantity}") for quantity in NAMES]
        covariance = com_covariance(e.mean[places], e.covariance[np.ix_(places, places)])
        t_s = (e.t_ns - start_ns) * 1e-9
        body = e.bodies[name]
        found.append(Guess(t_s=t_s, body=body, covariance_m2=covariance, reason=e.reason))
    return found


def com_covariance(pi: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) [m2] of the centre of mass of parameters pi (10,), (10, 10)."""
    T = report_jacobian(pi)[1:4]
    return np.asarray(T @ covariance @ T.T)


def ellipsoid(covariance_m2: FloatArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axes as columns of a rotation (3, 3), and the 3 sigma semi-axes (3,) [m].

    Order and signs of the axes are free; those nearest to the rotation `near` are chosen, so that
    an ellipsoid does not jump from one time to the next.
    """
    values, vectors = np.linalg.eigh(covariance_m2)
    semi_m = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    order = max(
        ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]),
        key=lambda order: float(np.abs(np.einsum("ij,ij->j", vectors[:, order], near)).sum()),
    )
    along = np.einsum("ij,ij->j", vectors[:, order], near)
    axes = vectors[:, order] * np.where(along < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, np.argmin(np.abs(along))] *= -1.0
    return axes, semi_m[order]


def magnification(semi_axes_m: FloatArray, reach_m: float) -> float:
    """Return the factor on a drawn ellipsoid: the least of 1, 2, 5, 10 ... that shows it."""
    least = LEAST_SEEN * reach_m / max(float(semi_axes_m.max()), 1e-12)
    decade = 10.0 ** np.floor(np.log10(least))
    return max(1.0, next(float(step * decade) for step in (1, 2, 5, 10) if step * decade >= least))


def read_truth(path: Path, names: Sequence[str]) -> dict[str, FloatArray]:
    """Return mass [kg] and centre of mass [m] (4,) of the named bodies that a JSON file has.

    The file is {BODY: {mass_kg, com_m}}, or has that under `truth`, as result.json of the bench.

    Raises
    ------
    ConfigError when it cannot be read, or has none of the bodies.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        told: Mapping[str, Any] = values.get("truth", values)
        found = {
            name: np.array([told[name]["mass_kg"], *told[name]["com_m"]], np.float64)
            for name in names
            if name in told
        }
    except OSError as error:
        raise ConfigError(f"--truth {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"--truth {path}: BODY: mass_kg, com_m: {error!r}") from error
    if not found or any(row.shape != (4,) or not np.isfinite(row).all() for row in found.values()):
        raise ConfigError(f"--truth {path}: must hold mass_kg and com_m of {' or '.join(names)}")
    return found


def parameters(body: BodyEstimate) -> FloatArray:
    """Return pi (10,) of an estimated body."""
    return to_parameters(body.mass_kg, body.com_m, body.inertia_kg_m2)
