"""One design problem: criterion and limits as functions of a trajectory's free control points.

Samples lie at the middle of equal steps. Criterion and limits are differentiated exactly: the
criterion in reverse mode (one sweep of the per-sample functions for any number of variables), the
limits in forward mode, sample by sample, because each row depends on few control points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsw.messages import FloatArray
from planner import attitude, criteria
from planner.collision import Collisions
from planner.kernel import MOTION_OUTPUTS
from planner.limits import JointLimits, MotionLimits
from planner.shaking import Shaking
from planner.spline import SplineLayout
from planner.subject import Subject

EFFORT_SMOOTHING_NM = 1e-3  # |tau| as sqrt(tau^2 + this^2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignRows:
    """Limit rows lower <= value <= upper of one kind, over all samples, and their Jacobian.

    For `power` 1, `value * size` is in `unit`; for `power` 2, `sqrt(value) * size` is. A value that
    is a share of its bound is 1 at the bound.
    """

    kind: str
    unit: str
    size: float
    power: int
    value: FloatArray  # (m,)
    lower: FloatArray
    upper: FloatArray
    by_z: FloatArray | None  # (m, rows * n)


class Grid:
    """Samples of a motion at the middle of equal steps, as linear functions of the variables z."""

    def __init__(self, layout: SplineLayout, rate_hz: float) -> None:
        self.count = int(np.ceil(layout.duration_s * rate_hz))
        self.step_s = layout.duration_s / self.count
        self.t_s: FloatArray = self.step_s * np.arange(0.5, self.count)
        self.layout = layout
        self.weights = layout.weights(self.t_s)

    def motion(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, qd, qdd, each (n, m), with one column per sample [rad or m, s]."""
        points = z.reshape(self.layout.rows, self.layout.n)
        q, qd, qdd = (self.weights[d] @ points for d in range(3))
        return q.T.copy(), qd.T.copy(), qdd.T.copy()

    def pulled_back(self, seeds: FloatArray) -> FloatArray:
        """Return a function's gradient (v,) with respect to z.

        `seeds` (3 n, m) is its gradient with respect to [q; qd; qdd] at every sample.
        """
        n = self.layout.n
        parts = [self.weights[d].T @ seeds[d * n : (d + 1) * n].T for d in range(3)]
        return np.asarray(np.sum(parts, axis=0).ravel())


class Criterion:
    """A criterion averaged over a set of parameter vectors, with its gradient.

    Parameters
    ----------
    members : parameter vectors (p,) besides the subject's own
    """

    def __init__(
        self,
        subject: Subject,
        grid: Grid,
        name: criteria.Name,
        gamma: criteria.Gamma,
        members: Sequence[FloatArray] = (),
    ) -> None:
        self.subject, self.grid, self.name, self.gamma = subject, grid, name, gamma
        self.members = [subject.x, *members]
        self._last: tuple[bytes, list[tuple[criteria.Value, FloatArray, FloatArray]]] = (b"", [])

    def value(self, z: FloatArray) -> float:
        """Return the value to minimise (usually a logarithm of the criterion)."""
        return float(np.mean([found.value for found, _, _ in self._all(z)]))

    def gradient(self, z: FloatArray) -> tuple[float, FloatArray]:
        """Return value and gradient (v,)."""
        gradient = np.zeros(z.size)
        for x, (found, *outputs) in zip(self.members, self._all(z), strict=True):
            gradient += self._reverse(z, x, found, outputs)
        return self.value(z), gradient / len(self.members)

    def _all(self, z: FloatArray) -> list[tuple[criteria.Value, FloatArray, FloatArray]]:
        """Return the forward sweep of every member; the sweeps of the last z are cached."""
        key = z.tobytes()
        if self._last[0] != key:
            self._last = (key, [self._forward(z, x) for x in self.members])
        return self._last[1]

    def _columns(self, z: FloatArray, x: FloatArray) -> list[FloatArray]:
        return [*self.grid.motion(z), np.tile(x[:, None], (1, self.grid.count))]

    def _forward(
        self, z: FloatArray, x: FloatArray
    ) -> tuple[criteria.Value, FloatArray, FloatArray]:
        kernel, grid = self.subject.kernel, self.grid
        inputs = self._columns(z, x)
        if self.name in criteria.REGRESSOR_CRITERIA:
            J, tau = (np.asarray(out.full()) for out in kernel.regressor(*inputs))
            J = J.reshape(kernel.n, grid.count, -1)
            root = criteria.triangular_root(grid.step_s**0.5 * J.reshape(-1, J.shape[2]))
            effort = grid.step_s * float(np.sqrt(tau**2 + EFFORT_SMOOTHING_NM**2).sum())
            return criteria.regressor(self.name, root, effort, self.gamma), J, tau
        X = np.asarray(kernel.information(*inputs).full())
        X = X.reshape(len(X), grid.count, kernel.states)
        flat = X.reshape(-1, kernel.states)
        stacked = np.vstack([self.subject.prior_root, grid.step_s**0.5 * flat])
        found = criteria.fused(self.name, criteria.triangular_root(stacked), self.subject.scale)
        return found, X, np.empty(0)

    def _reverse(
        self, z: FloatArray, x: FloatArray, found: criteria.Value, outputs: list[FloatArray]
    ) -> FloatArray:
        kernel, grid = self.subject.kernel, self.grid
        inputs = self._columns(z, x)
        if found.by_M is not None:
            J, tau = outputs
            seed = 2 * grid.step_s * (J @ found.by_M).reshape(kernel.n, -1)
            slope = tau / np.sqrt(tau**2 + EFFORT_SMOOTHING_NM**2)
            back = kernel.regressor_adjoint(*inputs, seed, found.by_effort * grid.step_s * slope)
        elif found.by_F is not None:
            X = outputs[0]
            seed = 2 * grid.step_s * (X @ found.by_F).reshape(len(X), -1)
            back = kernel.information_adjoint(*inputs, seed)
        else:
            raise ValueError("a criterion without derivatives")
        return grid.pulled_back(np.asarray(back.full()))


class LimitRows:
    """All limits of a motion as rows, for one or several parameter vectors."""

    def __init__(
        self,
        subject: Subject,
        grid: Grid,
        limits: MotionLimits,
        collisions: Collisions | None,
    ) -> None:
        self.subject, self.grid, self.limits, self.collisions = subject, grid, limits, collisions
        self.joints = JointLimits(limits, subject.model)
        self.names = subject.model.joint_names
        self.modes = [
            (
                f"mode {mode.name}" + f" {k}" * (len(mode.axes_B) > 1),
                "rad" if mode.kind == "panel" else "m",
                limits.mode_amplitude[mode.name],
                Shaking(mode, k, grid.count, grid.step_s),
            )
            for mode in subject.config.modes
            if mode.name in limits.mode_amplitude
            for k in range(len(mode.axes_B))
        ]

    def rows(
        self, z: FloatArray, members: Sequence[FloatArray], *, derivatives: bool = False
    ) -> list[DesignRows]:
        """Return the rows of every limit; only dynamic limits depend on `members`, (p,) each."""
        found = self._joint_rows(z, derivatives)
        for k, x in enumerate(members):
            found += self._dynamic_rows(z, x, derivatives, geometric=k == 0)
        if self.collisions is not None:
            found += self._collision_rows(z, self.collisions, derivatives)
        return found

    def _joint_rows(self, z: FloatArray, derivatives: bool) -> list[DesignRows]:
        grid, own = self.grid, self.joints
        points = z.reshape(grid.layout.rows, grid.layout.n)
        half = 0.5 * (own.upper_rad - own.lower_rad)
        is_ranged = np.isfinite(half)
        middle = np.where(is_ranged, own.upper_rad, 0.0) - np.where(is_ranged, half, 0.0)
        none = np.zeros_like(half)
        kinds = (
            ("joint_range", half, middle),
            ("joint_speed", own.speed_rad_s, none),
            ("joint_acceleration", own.acceleration_rad_s2, none),
            ("joint_jerk", own.jerk_rad_s3, none),
        )
        found = []
        for d, (kind, bound, offset) in enumerate(kinds):
            for j, name in enumerate(self.names):
                if not np.isfinite(bound[j]):
                    continue
                W = grid.weights[d] / bound[j]
                by_z = None
                if derivatives:
                    full = np.zeros((grid.count, grid.layout.rows, grid.layout.n))
                    full[:, :, j] = W
                    by_z = full.reshape(grid.count, -1)
                value = W @ points[:, j] - offset[j] / bound[j]
                unit = own.units[j] + ("", "/s", "/s^2", "/s^3")[d]
                found.append(_both(f"{kind} {name}", unit, float(bound[j]), value, by_z))
        return found

    def _dynamic_rows(
        self, z: FloatArray, x: FloatArray, derivatives: bool, *, geometric: bool
    ) -> list[DesignRows]:
        kernel, grid, bounds, n = self.subject.kernel, self.grid, self.limits, self.subject.kernel.n
        inputs = [*grid.motion(z), np.tile(x[:, None], (1, grid.count))]
        J: FloatArray | None = None
        if derivatives:
            out, D = (np.asarray(part.full()) for part in kernel.motion_jacobian(*inputs))
            rows = n + MOTION_OUTPUTS
            D = D.reshape(rows, grid.count, 3, n)
            J = np.einsum("ckdj,dkr->ckrj", D, grid.weights[:3]).reshape(rows, grid.count, -1)
        else:
            out = np.asarray(kernel.motion(*inputs).full())
        tau, (w, wd, p_BE, a) = out[:n], out[n:].reshape(4, 3, -1).transpose(0, 2, 1)
        found = []
        for j, name in enumerate(self.names):
            bound = self.joints.torque_nm[j]
            by_z = None if J is None else J[j] / bound
            kind, unit = ("torque", "N m") if self.joints.units[j] == "rad" else ("force", "N")
            found.append(_both(f"{kind} {name}", unit, float(bound), tau[j] / bound, by_z))
        J_w = None if J is None else J[n : n + 3].transpose(1, 0, 2)
        J_wd = None if J is None else J[n + 3 : n + 6].transpose(1, 0, 2)
        found.append(_square("base_rate", "rad/s", w, J_w, bounds.base_rate_rad_s))
        bound_wd = bounds.base_acceleration_rad_s2
        found.append(_square("base_acceleration", "rad/s^2", wd, J_wd, bound_wd))
        found.append(self._attitude_rows(w, J_w))
        J_a = None if J is None else J[n + 9 :].transpose(1, 0, 2)
        for name, unit, amplitude, shaking in self.modes:
            by_z = None if J_a is None or J_w is None or J_wd is None else (J_a, J_wd, J_w)
            found.append(_square(name, unit, *shaking.swing((a, wd, w), by_z), amplitude))
        if geometric:
            J_p = None if J is None else J[n + 6 : n + 9].transpose(1, 0, 2)
            found += self._tool_rows(p_BE, J_p)
        return found

    def _attitude_rows(self, w: FloatArray, J_w: FloatArray | None) -> DesignRows:
        grid, bound = self.grid, self.limits.base_attitude_rad
        R = attitude.attitudes(w, grid.step_s)
        phi = attitude.excursions(R)
        by_z = None
        if J_w is not None:
            by_z = attitude.half_square_gradient(w, R, phi, grid.step_s, J_w) * 2 / bound**2
        square = np.sum(phi**2, axis=1) / bound**2
        return _squared("base_attitude", "rad", bound, square, by_z)

    def _tool_rows(self, p_BE: FloatArray, J_p: FloatArray | None) -> list[DesignRows]:
        R, origin = self.subject.arm.R[0], self.subject.arm.p[0]
        tool = (p_BE - origin) @ R
        J = None if J_p is None else np.einsum("ij,kiv->kjv", R, J_p)
        found = []
        for axis, (low, high) in enumerate(self.limits.tool_box_m):
            if low is None and high is None:
                continue
            lower = np.full(len(tool), -np.inf if low is None else low)
            upper = np.full(len(tool), np.inf if high is None else high)
            by_z = None if J is None else J[:, axis]
            found.append(_metres(f"tool_box_{'xyz'[axis]}", tool[:, axis], by_z, lower, upper))
        least = self.limits.tool_distance_m
        if least > 0:
            distance = np.linalg.norm(tool, axis=1)
            by_z = None if J is None else np.einsum("ki,kiv->kv", tool / distance[:, None], J)
            ones = np.ones(len(tool))
            found.append(_metres("tool_distance", distance, by_z, least * ones, np.inf * ones))
        return found

    def _collision_rows(
        self, z: FloatArray, collisions: Collisions, derivatives: bool
    ) -> list[DesignRows]:
        q = self.grid.motion(z)[0].T
        distance, by_q = collisions.distances(q, derivatives=derivatives)
        clearance = self.limits.clearance_m or 0.0
        found, ones = [], np.ones(len(q))
        for k, name in enumerate(collisions.names):
            by_z = None
            if derivatives:
                W = self.grid.weights[0]
                by_z = np.einsum("mj,mr->mrj", by_q[:, k], W).reshape(len(q), -1)
            found.append(
                _metres(f"clearance {name}", distance[:, k], by_z, clearance * ones, np.inf * ones)
            )
        return found


def _both(
    kind: str, unit: str, size: float, share: FloatArray, by_z: FloatArray | None
) -> DesignRows:
    ones = np.ones(len(share))
    return DesignRows(
        kind=kind, unit=unit, size=size, power=1, value=share, lower=-ones, upper=ones, by_z=by_z
    )


def _squared(
    kind: str, unit: str, size: float, square: FloatArray, by_z: FloatArray | None
) -> DesignRows:
    ones = np.ones(len(square))
    return DesignRows(
        kind=kind,
        unit=unit,
        size=size,
        power=2,
        value=square,
        lower=-np.inf * ones,
        upper=ones,
        by_z=by_z,
    )


def _square(
    kind: str, unit: str, vectors: FloatArray, J: FloatArray | None, bound: float
) -> DesignRows:
    share = vectors / bound
    by_z = None if J is None else 2 / bound * np.einsum("ki,kiv->kv", share, J)
    return _squared(kind, unit, bound, np.sum(share**2, axis=1), by_z)


def _metres(
    kind: str, value: FloatArray, by_z: FloatArray | None, lower: FloatArray, upper: FloatArray
) -> DesignRows:
    return DesignRows(
        kind=kind, unit="m", size=1.0, power=1, value=value, lower=lower, upper=upper, by_z=by_z
    )
