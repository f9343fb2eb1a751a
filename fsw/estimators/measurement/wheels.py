"""Reaction wheels: their momentum and torque as known inputs of the base.

A wheel k turns with the measured speed relative to the base about an axis a_k fixed in it. Beside
its mass and locked inertia, which are in the base's own inertial data, it adds, in base axes,

    momentum  h = sum a_k h_k (1 + s_k),         h_k = J_k speed_k
    moment    d/dt h + w x h                     on the side of the inertia forces

The relative error s_k of a wheel's inertia is a state with a prior, and so is the error t_k of the
delay of its readings. A reading shows the motion t_k earlier, so h_k is evaluated at t + t_k, to
first order. Neither momentum nor moment depends on the unknown bodies. Source: Wie, Space Vehicle
Dynamics and Control (2008), sec. 7.3 (gyrostat).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem
from fsw.estimators.polynomial import gauss_nodes
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """Momentum of all wheels and its derivative at the nodes, with their sensitivities."""

    h_nms: FloatArray  # (N, 3) in base axes
    hd_nm: FloatArray  # (N, 3) its derivative in base axes
    axes: FloatArray  # (3, k) of the wheels, each times its 1 + s_k
    J_h: FloatArray  # (N, 3, p) d h/dx
    J_hd: FloatArray  # (N, 3, p)

    def moment(self, w: FloatArray) -> FloatArray:
        """Return d/dt h + w x h (N, 3) for the base's rate w (N, 3)."""
        return self.hd_nm + cross(w, self.h_nms)

    def by_rate(self) -> FloatArray:
        """Return d(moment)/dw (N, 3, 3)."""
        return -skew(self.h_nms)

    def by_state(self, w: FloatArray) -> FloatArray:
        """Return d(moment)/dx (N, 3, p) at a fixed rate."""
        moment: FloatArray = self.J_hd + skew(w) @ self.J_h
        return moment

    def by_motion(self, w: FloatArray) -> FloatArray:
        """Return d(moment)/d[h_k, d/dt h_k] (2, N, 3, k)."""
        by = np.empty((2, len(w), *self.axes.shape))
        by[0], by[1] = skew(w) @ self.axes, self.axes
        return by


def turning(s: BlockStack, x: FloatArray, problem: Problem) -> Wheels | None:
    """Return the wheels' momentum, with sensitivities, at the nodes; None for no wheels.

    Raises
    ------
    ValueError if the blocks are of a robot with other wheels.
    """
    count = problem.wheel_axes.shape[1]
    if s.wheel_nms.shape[1] != count:
        raise ValueError(f"blocks of {s.wheel_nms.shape[1]} wheels; the robot has {count}")
    if not count:
        return None
    axes, N = problem.wheel_axes, len(s.q_rad)
    h, hd = s.wheel_nms, s.wheel_nm
    J_h, J_hd = np.zeros((2, N, 3, len(x)))
    scaled = axes
    if problem.has("wheel_scale"):
        scaled = axes * (1.0 + x[problem.at("wheel_scale")])
    if problem.has("wheel_delay"):
        slope = s.by_block(hd)
        hdd = (_differentiation(s.m) @ slope).reshape(hd.shape) * (2.0 / problem.window_s)
        J_h[:, :, problem.at("wheel_delay")] = scaled * hd[:, None]
        J_hd[:, :, problem.at("wheel_delay")] = scaled * hdd[:, None]
        late_s = x[problem.at("wheel_delay")]
        h, hd = h + late_s * hd, hd + late_s * hdd
    if problem.has("wheel_scale"):
        J_h[:, :, problem.at("wheel_scale")] = axes * h[:, None]
        J_hd[:, :, problem.at("wheel_scale")] = axes * hd[:, None]
    return Wheels(h @ scaled.T, hd @ scaled.T, scaled, J_h, J_hd)


@lru_cache(maxsize=8)
def _differentiation(nodes: int) -> FloatArray:
    """Return (m, m): derivatives at the Gauss nodes on [-1, 1] of the interpolant of the values."""
    points = gauss_nodes(nodes)
    values = legendre.legvander(points, nodes - 1)
    slopes = legendre.legval(points, legendre.legder(np.eye(nodes))).T
    return np.asarray(np.linalg.solve(values.T, slopes.T).T, np.float64)
