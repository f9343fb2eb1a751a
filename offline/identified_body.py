"""An identified body with covariance and verdict, read from the JSON of a result."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config.text import kind_of
from fsw.errors import ConfigError
from fsw.estimators.model.inertia import (
    NAMES,
    from_parameters,
    nearest_consistent,
    report_jacobian,
    to_parameters,
)
from fsw.messages import FloatArray

AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
FRAMES = {"base": "base", "target": "tool"}  # any other body has the frame bodies.NAME.frame
QUANTITIES = ("mass_kg", *(f"com_{a}_m" for a in "xyz"), *(f"inertia_{a}_kg_m2" for a in AXES))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A physically consistent body in frame B (base), E (target) or bodies.NAME.frame (others)."""

    name: str
    mass_kg: float
    com_m: FloatArray  # (3,)
    inertia_kg_m2: FloatArray  # (6,) xx xy xz yy yz zz about the centre of mass
    covariance: FloatArray  # (10, 10) of `values`
    reasons: tuple[str, ...]  # why not valid, the most severe first; empty when valid
    frame: str  # name of the frame of com_m and inertia_kg_m2

    @property
    def valid(self) -> bool:
        """Whether the body may be used."""
        return not self.reasons

    @property
    def reason(self) -> str:
        """The most severe reason why the body is not valid; empty when valid."""
        return next(iter(self.reasons), "")

    def values(self) -> FloatArray:
        """Return mass [kg], centre of mass [m] and inertia [kg m^2] as one array (10,)."""
        return np.concatenate(([self.mass_kg], self.com_m, self.inertia_kg_m2))

    def sigma(self) -> FloatArray:
        """Return 1 sigma of `values` (10,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def body_of(result: Mapping[str, Any], name: str | None) -> Body:
    """Return a body of the values that `fsw identify --json` or `fsw replay --json` print.

    Raises
    ------
    ConfigError for an unknown body, for None if there are several, or for values of another form.
    """
    try:
        known = [str(body) for body in result["estimate"]]
        if name is None and len(known) == 1:
            name = known[0]
        if name is None or name not in known:
            raise ConfigError(f"--body {name}: must be one of {', '.join(known) or 'none'}")
        found = result["estimate"][name]
        places = [list(result["names"]).index(f"{name}.{quantity}") for quantity in NAMES]
        state = np.array(result["covariance"], np.float64)[np.ix_(places, places)]
        worst = str(result["reason"] if "valid" in result else result["status"])
        reasons = tuple(map(str, result.get("reasons", [worst] * (worst not in ("", "OK")))))
        frame = str((FRAMES | dict(result.get("frames") or {})).get(name, "own"))
        with np.errstate(all="ignore"):  # values that are not finite are refused below
            pi = to_parameters(found["mass_kg"], found["com_m"], found["inertia_kg_m2"])
            mass, com, inertia = from_parameters(nearest_consistent(pi, state))
            T = report_jacobian(pi)
            covariance = T @ state @ T.T
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, ConfigError):
            raise
        words = "must be what fsw identify --json or fsw replay --json printed (hil run: not so)"
        raise ConfigError(f"{words}: {error!r}") from error
    values = np.array([mass, *com, *inertia])
    if not (np.isfinite(values).all() and np.isfinite(covariance).all() and min(mass, pi[0]) > 0.0):
        raise ConfigError(f"{name}: mass must be positive, every value and covariance finite")
    if np.diag(state).min() < 0.0:
        raise ConfigError(f"{name}: the covariance has a negative variance")
    return Body(
        name=name,
        mass_kg=mass,
        com_m=com,
        inertia_kg_m2=inertia,
        covariance=covariance,
        reasons=reasons,
        frame=frame,
    )


def read_result(path: Path) -> Mapping[str, Any]:
    """Return the values of a result file (JSON).

    Raises
    ------
    ConfigError when the file cannot be read or is not a JSON object.
    """
    try:
        source = path.read_bytes()
        values = json.loads(source)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        words = f"it is {kind_of(source) or 'not JSON'}"
        raise ConfigError(f"{path}: not a result of fsw identify --out: {words}") from error
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: not a result of fsw identify --out")
    return values
