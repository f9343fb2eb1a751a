"""IPOPT on one design problem: exact gradients, curvature from limited-memory updates.

CasADi contains IPOPT. Criterion and limits are Python callbacks, because the criterion's derivative
goes through one small dense matrix (the information) that is not worth an expression graph.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fsw.messages import FloatArray
from planner.design import Criterion, DesignRows, LimitRows

OBJECTIVE_SCALE = 30.0  # weight of one nat of the criterion against one whole limit
FEASIBLE = 1e-4  # violation in the rows' scale that the margins of the dense check cover

Progress = Callable[[int, float, str, float], None]  # iteration, value, worst limit, its excess


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionSolution:
    """The motion that the solver found; the dense check decides whether it is feasible."""

    z: FloatArray
    status: str
    iterations: int
    gradients: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """Stopping rule of the solver."""

    iterations: int
    tolerance: float = 1e-3


def optimise(
    criterion: Criterion,
    limits: LimitRows,
    members: Sequence[FloatArray],
    start: FloatArray,
    fixed: Mapping[int, float],
    margins: Mapping[str, float],
    effort: Effort,
    progress: Progress | None = None,
) -> MotionSolution:
    """Minimise the criterion within the limits, from the variables `start` (v,).

    Parameters
    ----------
    members : parameter vectors (p,) for which the limits must hold
    fixed : values of fixed variables, by index
    margins : by kind of limit, the share of its bound to leave free (metres for distances)
    """
    problem = _Problem(criterion, limits, members, start, margins, progress)
    lower, upper = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    for index, value in fixed.items():
        lower[index] = upper[index] = value
    options: Any = {
        "print_time": False,
        "error_on_fail": False,
        "calc_lam_x": False,
        "calc_lam_p": False,
        "no_nlp_grad": True,
        "grad_f": problem.gradient,
        "jac_g": problem.jacobian,
        "ipopt": {
            "hessian_approximation": "limited-memory",
            "max_iter": effort.iterations,
            "tol": effort.tolerance,
            "acceptable_tol": 10 * effort.tolerance,
            "constr_viol_tol": 1e-4,
            "obj_scaling_factor": OBJECTIVE_SCALE,
            "mu_strategy": "adaptive",
            "print_level": 0,
            "sb": "yes",
        },
    }
    solver = ca.nlpsol("excite", "ipopt", problem.oracle, options)
    found = solver(x0=start, lbx=lower, ubx=upper, lbg=problem.lower, ubg=problem.upper)
    stats = solver.stats()
    return MotionSolution(
        z=problem.best(np.asarray(found["x"].full()).ravel()),
        status=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
        gradients=problem.gradients,
    )


class _Problem:
    """The callbacks of one solver run and the values that they share."""

    def __init__(
        self,
        criterion: Criterion,
        limits: LimitRows,
        members: Sequence[FloatArray],
        start: FloatArray,
        margins: Mapping[str, float],
        progress: Progress | None,
    ) -> None:
        self._criterion, self._limits, self._members = criterion, limits, members
        self._progress = progress
        self.gradients = 0
        self._worst = ("", np.inf)
        self._best: tuple[float, FloatArray] = (np.inf, start)
        self._last: tuple[bytes, FloatArray] = (b"", np.empty(0))
        rows = limits.rows(start, members, derivatives=True)
        self.lower, self.upper = _bounds(rows, margins)
        mask = np.vstack([self._pattern(row) for row in rows])
        self._index = np.nonzero(mask.T)  # column by column, as CasADi stores
        sparsity = ca.Sparsity.triplet(
            mask.shape[0], mask.shape[1], self._index[1].tolist(), self._index[0].tolist()
        )
        v, m = start.size, len(self.lower)
        column, scalar = ca.Sparsity.dense(v, 1), ca.Sparsity.dense(1, 1)
        self.oracle = _Function(
            "oracle", v, [scalar, ca.Sparsity.dense(m, 1)], self._values, ("f", "g")
        )
        self.gradient = _Function("grad_f", v, [scalar, column], self._gradient)
        self.jacobian = _Function("jac_g", v, [ca.Sparsity.dense(m, 1), sparsity], self._jacobian)
        self._sparsity = sparsity

    def _pattern(self, row: DesignRows) -> np.ndarray:
        """Return (m, v): whether a row can depend on a variable, by its or any earlier sample."""
        grid, n = self._limits.grid, self._limits.grid.layout.n
        support = np.any(grid.weights[:3] != 0, axis=0)
        if row.kind == "base_attitude" or row.kind.startswith("mode "):
            support = np.cumsum(support, axis=0) > 0
        elif row.kind.startswith("joint_"):
            joint = self._limits.names.index(row.kind.split(" ", 1)[1])
            support = np.any(grid.weights != 0, axis=0)
            pattern = np.zeros((*support.shape, n), dtype=bool)
            pattern[:, :, joint] = support
            return pattern.reshape(len(support), -1)
        return np.repeat(support, n, axis=1)

    def best(self, last: FloatArray) -> FloatArray:
        """Return the last iterate, or the best feasible one if that is better."""
        value, _ = self._values(last)
        worse = self._worst[1] > FEASIBLE or value > self._best[0]
        return self._best[1] if worse and np.isfinite(self._best[0]) else last

    def _values(self, z: FloatArray) -> list[Any]:
        key = z.tobytes()
        if self._last[0] != key:
            rows = self._limits.rows(z, self._members)
            g = np.concatenate([row.value for row in rows])
            excess = np.maximum(g - self.upper, self.lower - g)
            k = int(excess.argmax())
            ends = np.cumsum([len(row.value) for row in rows])
            self._worst = (rows[int(np.searchsorted(ends, k, side="right"))].kind, float(excess[k]))
            self._last = (key, g)
        return [self._criterion.value(z), self._last[1]]

    def _gradient(self, z: FloatArray) -> list[Any]:
        self.gradients += 1
        value, gradient = self._criterion.gradient(z)
        if self._worst[1] <= FEASIBLE and value < self._best[0]:
            self._best = (value, z.copy())
        if self._progress is not None:
            self._progress(self.gradients, value, *self._worst)
        return [value, gradient]

    def _jacobian(self, z: FloatArray) -> list[Any]:
        rows = self._limits.rows(z, self._members, derivatives=True)
        stacked = np.vstack([row.by_z for row in rows if row.by_z is not None])
        values = stacked[self._index[1], self._index[0]]
        return [np.concatenate([row.value for row in rows]), ca.DM(self._sparsity, values)]


class _Function(ca.Callback):
    """A Python function as a CasADi callback with the inputs x and p; p is empty."""

    def __init__(
        self,
        name: str,
        size: int,
        outputs: list[ca.Sparsity],
        call: Callable[[FloatArray], list[Any]],
        names: tuple[str, ...] = (),
    ) -> None:
        ca.Callback.__init__(self)
        self._size, self._outputs, self._call, self._names = size, outputs, call, names
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return ("x", "p")[i]

    def get_name_out(self, i: int) -> str:
        return self._names[i] if self._names else f"o{i}"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._size, 1) if i == 0 else ca.Sparsity.dense(0, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outputs[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        return self._call(np.asarray(arguments[0].full()).ravel())


def _bounds(
    rows: Sequence[DesignRows], margins: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    lower, upper = [], []
    for row in rows:
        margin = row.power * margins.get(row.kind, 0.0)
        lower.append(row.lower + margin)
        upper.append(row.upper - margin)
    return np.concatenate(lower), np.concatenate(upper)
