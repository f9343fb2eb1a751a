"""States of estimators as plain values, for checkpoints and for restarts from them.

A state is a mapping of numbers, text, None, arrays, lists and further mappings. Its values are
copies. Put into an object of the same problem, they make it continue exactly from this state.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fsw.errors import EstimatorError
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.model.problem import Problem
from fsw.estimators.square_root import SquareRootInformation

Values = Mapping[str, Any]


def kept(owner: object, names: Sequence[str]) -> dict[str, Any]:
    """Return the named attributes, arrays copied; a leading underscore is not part of the key."""
    values = {name.lstrip("_"): getattr(owner, name) for name in names}
    return {
        key: value.copy() if isinstance(value, np.ndarray) else value
        for key, value in values.items()
    }


def put(owner: object, names: Sequence[str], values: Values) -> None:
    """Set the named attributes to the values that `kept` returned."""
    for name in names:
        value = values[name.lstrip("_")]
        setattr(owner, name, value.copy() if isinstance(value, np.ndarray) else value)


def check_fit(problem: Problem, values: Values) -> None:
    """Check that a stored state is of these unknowns.

    Raises
    ------
    EstimatorError if it is not.
    """
    if tuple(values["names"]) != problem.names:
        raise EstimatorError("the state is of other unknowns than this estimator's")


def from_information(information: SquareRootInformation | None) -> dict[str, Any] | None:
    """Return the factor and right-hand side as plain values; None for None."""
    return None if information is None else {"R": information.R, "z": information.z}


def to_information(values: Values) -> SquareRootInformation:
    """Return the information from the values of `from_information`."""
    return SquareRootInformation(np.asarray(values["R"]), np.asarray(values["z"]))


def from_impulse(impulse: Impulse | None) -> dict[str, Any] | None:
    """Return an impulse as plain values, with firings and modes only if there are any."""
    if impulse is None:
        return None
    fired = ("fired_s",) if isinstance(impulse.fired_s, np.ndarray) else ()
    modes = ("modes", "J_modes", "doubt") if len(impulse.modes) else ()
    motion = ("motion", "J_motion", "cov_motion") if len(impulse.motion) else ()
    return kept(impulse, ("end_ns", "L_Nms", "J", "x", *fired, *modes, *motion))


def to_impulse(values: Values | None) -> Impulse | None:
    """Return the impulse from the values of `from_impulse`."""
    return None if values is None else Impulse(**values)
