"""The planner's exact gradients: their error against finite differences."""

from collections.abc import Callable

import numpy as np

from evidence.excitation.cases import planner
from hil.world.inertia import FloatArray
from planner import criteria
from planner.design import Criterion
from planner.subject import Subject

STEPS = (1e-3, 3e-4, 1e-4)  # steps along a random direction [rad]; the smallest error counts


def criterion_error(own: Subject, name: criteria.Name, seed: int = 0) -> float:
    """Return the relative error of a criterion's gradient along a random direction."""
    one = planner(own)
    rng = np.random.default_rng(seed)
    z = one.guesses.random_feasible(rng)
    if z is None:
        raise ValueError("no feasible motion drawn")
    criterion = Criterion(own, one.grid, name, one.request.gamma)
    direction = rng.standard_normal(z.size)
    exact = float(criterion.gradient(z)[1] @ direction)
    found = [_derivative(criterion.value, z, direction, h) for h in STEPS]
    return min(abs(exact / value - 1) for value in found)


def limits_error(own: Subject, seed: int = 0) -> float:
    """Return the largest relative error of the limits' Jacobian along a random direction."""
    one = planner(own)
    rng = np.random.default_rng(seed)
    z = one.guesses.random_feasible(rng)
    if z is None:
        raise ValueError("no feasible motion drawn")
    direction, h = rng.standard_normal(z.size), 1e-5
    rows = one.rows.rows(z, [own.x], derivatives=True)
    plus, minus = (
        one.rows.rows(z + h * direction, [own.x]),
        one.rows.rows(z - h * direction, [own.x]),
    )
    errors = []
    for row, above, below in zip(rows, plus, minus, strict=True):
        if row.by_z is None:
            continue
        numeric = (above.value - below.value) / (2 * h)
        errors.append(float(np.abs(row.by_z @ direction - numeric).max() / np.abs(numeric).max()))
    return max(errors)


def _derivative(
    call: Callable[[FloatArray], float], z: FloatArray, direction: FloatArray, h: float
) -> float:
    """Return the derivative along a direction by a central difference of fourth order."""
    near = call(z + h * direction) - call(z - h * direction)
    far = call(z + 2 * h * direction) - call(z - 2 * h * direction)
    return (8 * near - far) / (12 * h)
