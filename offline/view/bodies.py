"""The unknown bodies over time: centre of mass, its ellipsoid, and the truth if it is known."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from fsw.errors import ConfigError
from fsw.estimators.model.inertia import NAMES, report_jacobian, to_parameters
from fsw.messages import BodyEstimate, Estimate, FloatArray

SIGMAS = 3.0
LEAST_SEEN = 0.1  # least ratio of longest semi-axis to reach; a smaller ellipsoid is magnified


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guess:
    """Estimate of a body, shown from the time t_s on; all values are in the body's frame."""

    t_s: float
    body: BodyEstimate
    covariance_m2: FloatArray  # (3, 3) covariance of the centre of mass
    reason: str = ""  # why not valid; empty when valid


def guesses(estimates: Sequence[Estimate], name: str, start_ns: int) -> list[Guess]:
    """Return the estimates of the body `name`, with times from `start_ns`."""
    found = []
    for e in estimates:
        places = [e.names.index(f"{name}.{quantity}") for quantity in NAMES]
        covariance = com_covariance(e.mean[places], e.covariance[np.ix_(places, places)])
        t_s = (e.t_ns - start_ns) * 1e-9
        body = e.bodies[name]
        found.append(
            Guess(t_s=t_s, body=body, covariance_m2=covariance, reason=", ".join(e.reasons))
        )
    return found


def com_covariance(pi: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the centre of mass's covariance (3, 3) [m^2] from pi (10,) and its (10, 10)."""
    T = report_jacobian(pi)[1:4]
    return np.asarray(T @ covariance @ T.T)


def ellipsoid(covariance_m2: FloatArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axes as columns of a rotation (3, 3), and the 3 sigma semi-axes (3,) [m].

    Order and signs of the axes are arbitrary. The function chooses those nearest to the rotation
    `near`, so that an ellipsoid does not jump from one time to the next.
    """
    values, vectors = np.linalg.eigh(covariance_m2)
    semi_m = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    likeness = np.abs(vectors.T @ near)  # of each axis (row) to each of `near`
    order = list(max(permutations(range(3)), key=lambda rows: likeness[list(rows), range(3)].sum()))
    along = np.einsum("ij,ij->j", vectors[:, order], near)
    axes = vectors[:, order] * np.where(along < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, np.argmin(np.abs(along))] *= -1.0
    return axes, semi_m[order]


def magnification(semi_axes_m: FloatArray, reach_m: float) -> float:
    """Return the least factor of 1, 2, 5, 10 ... that makes the drawn ellipsoid visible."""
    least = LEAST_SEEN * reach_m / max(float(semi_axes_m.max()), 1e-12)
    decade = 10.0 ** np.floor(np.log10(least))
    return max(1.0, next(float(step * decade) for step in (1, 2, 5, 10) if step * decade >= least))


def read_truth(path: Path, names: Sequence[str]) -> dict[str, FloatArray]:
    """Return mass [kg] and centre of mass [m] as (4,) for each of `names` in a JSON file.

    The file contains {BODY: {mass_kg, com_m}} itself, or under `truth` as in result.json of hil.

    Raises
    ------
    ConfigError when the file cannot be read or contains none of the bodies.
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
    """Return the inertial parameters pi (10,) of an estimated body."""
    return to_parameters(body.mass_kg, body.com_m, body.inertia_kg_m2)
