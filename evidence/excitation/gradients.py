"""The planner's exact gradients: their error against finite differences, and the time they save."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evidence.excitation.cases import planner
from hil.world.inertia import FloatArray
from planner import criteria
from planner.design import Criterion, DesignRows, LimitRows
from planner.plan import Planner
from planner.solver import Effort, optimise
from planner.subject import Subject

STEPS = (1e-3, 3e-4, 1e-4)  # steps along a random direction [rad]; the smallest error counts
FORWARD_STEP_RAD = 1e-6


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Race:
    """The same solver from the same start, with exact gradients and with finite differences."""

    exact_s: float  # processor time
    exact_value: float
    numeric_s: float  # processor time until `exact_value` was reached, or until the end
    numeric_value: float  # best value with finite differences
    reached: bool  # whether finite differences reached `exact_value`


def race(own: Subject, iterations: int, slack: float = 1e-3) -> Race:
    """Run both; finite differences must reach the exact run's value within `slack` (logarithm)."""
    one = planner(own)
    z = one.first_guess(np.random.default_rng(0))
    fast = _Clocked(own, one)
    solved = optimise(fast, one.rows, [own.x], z, {}, {}, Effort(iterations=iterations), fast.note)
    exact_s, wanted = fast.seconds(), fast.value(solved.z)
    slow = _Numeric(own, one, wanted + slack)
    rows = _NumericRows(own, one)
    optimise(slow, rows, [own.x], z, {}, {}, Effort(iterations=iterations), slow.note)
    reached = slow.reached_s is not None
    return Race(
        exact_s=exact_s,
        exact_value=wanted,
        numeric_s=slow.reached_s if slow.reached_s is not None else slow.seconds(),
        numeric_value=slow.best,
        reached=reached,
    )


class _Clocked(Criterion):
    """A criterion that measures the processor time since its construction."""

    def __init__(self, own: Subject, one: Planner) -> None:
        super().__init__(own, one.grid, one.request.criterion, one.request.gamma)
        self._began = time.process_time()

    def seconds(self) -> float:
        """Return the processor time since the construction [s]."""
        return time.process_time() - self._began

    def note(self, _iteration: int, value: float, _kind: str, excess: float) -> None:
        """Ignore the solver's progress."""


class _Numeric(_Clocked):
    """A criterion differentiated by forward differences."""

    def __init__(self, own: Subject, one: Planner, wanted: float) -> None:
        super().__init__(own, one)
        self._wanted = wanted
        self.best = np.inf
        self.reached_s: float | None = None

    def gradient(self, z: FloatArray) -> tuple[float, FloatArray]:
        """Return the value and the gradient by forward differences."""
        return self.value(z), _forward(lambda point: np.array([self.value(point)]), z)[0]

    def note(self, _iteration: int, value: float, _kind: str, excess: float) -> None:
        """Record the best feasible value, and when the wanted value was reached."""
        if excess > 1e-3:
            return
        self.best = min(self.best, value)
        if self.reached_s is None and value <= self._wanted:
            self.reached_s = self.seconds()


class _NumericRows(LimitRows):
    """Limits differentiated by forward differences."""

    def __init__(self, own: Subject, one: Planner) -> None:
        super().__init__(own, one.grid, one.limits, None)

    def rows(
        self, z: FloatArray, members: Sequence[FloatArray], *, derivatives: bool = False
    ) -> list[DesignRows]:
        """Return the rows of every limit; `derivatives` adds Jacobians by forward differences."""
        found = super().rows(z, members)
        if not derivatives:
            return found

        def stacked(point: FloatArray) -> FloatArray:
            return np.concatenate([row.value for row in LimitRows.rows(self, point, members)])

        J, start, result = _forward(stacked, z), 0, []
        for row in found:
            part = J[start : start + len(row.value)]
            start += len(row.value)
            result.append(
                DesignRows(
                    kind=row.kind,
                    unit=row.unit,
                    size=row.size,
                    power=row.power,
                    value=row.value,
                    lower=row.lower,
                    upper=row.upper,
                    by_z=part,
                )
            )
        return result


def _forward(call: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    """Return d call/dz (m, v) by forward differences."""
    first = call(z)
    columns = []
    for k in range(z.size):
        moved = z.copy()
        moved[k] += FORWARD_STEP_RAD
        columns.append((call(moved) - first) / FORWARD_STEP_RAD)
    return np.stack(columns, axis=1)
