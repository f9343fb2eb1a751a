"""Momentum that parts of the base carry by turning in it, as a known input.

The parts' mass and locked inertia are in the base's own inertial data. Beside these, they add to
the base, in its axes,

    momentum  h = sum a_k h_k (1 + s_k)
    moment    d/dt h + w x h                     on the side of the inertia forces

The momenta h_k about axes a_k fixed in the base, and their derivatives, are in the block with their
covariance. The relative error s_k of an inertia is a state with a prior, and so is the error t_k of
the delay of readings. A reading shows the motion t_k earlier, so h_k is evaluated at t + t_k, to
first order. Neither momentum nor moment depends on the unknown bodies. Source: Wie, Space
Vehicle Dynamics and Control (2008), sec. 7.3 (gyrostat).
"""

from dataclasses import dataclass

import numpy as np

from fsw.estimators.conditioning.polynomial import differentiation
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.model.inertia import cross, skew
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """Momentum of all parts and its derivative at the nodes, with their sensitivities."""

    h_nms: FloatArray  # (N, 3) in base axes
    hd_nm: FloatArray  # (N, 3) its derivative in base axes
    axes: FloatArray  # (3, k) of the parts, each times its 1 + s_k
    J_h: FloatArray  # (N, 3, p) dh/dx
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


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """Parts that turn about k axes fixed in the base."""

    axes: FloatArray  # (3, k) in B
    scale: slice | None  # states s_k; None: exact
    delay: slice | None  # states t_k
    window_s: float
    most_nms: FloatArray  # (k,) that each part can hold
    most_nm: FloatArray  # (k,) at which it can change

    def __call__(self, s: BlockStack, x: FloatArray) -> Carried | None:
        """Return the momentum at the nodes for a state x (p,); None if nothing carries any.

        Raises
        ------
        ValueError if the blocks are of a robot with other parts.
        """
        count = self.axes.shape[1]
        if s.carried_nms.shape[1] != count:
            raise ValueError(f"blocks of {s.carried_nms.shape[1]} momenta; the robot has {count}")
        if not count:
            return None
        axes, h, hd = self.axes, s.carried_nms, s.carried_nm
        J_h, J_hd = np.zeros((2, len(h), 3, len(x)))
        scaled = axes
        if self.scale is not None:
            scaled = axes * (1.0 + x[self.scale])
        if self.delay is not None:
            slope = s.by_block(hd)
            hdd = (differentiation(s.m) @ slope).reshape(hd.shape) * (2.0 / self.window_s)
            J_h[:, :, self.delay] = scaled * hd[:, None]
            J_hd[:, :, self.delay] = scaled * hdd[:, None]
            h, hd = h + x[self.delay] * hd, hd + x[self.delay] * hdd
        if self.scale is not None:
            J_h[:, :, self.scale] = axes * h[:, None]
            J_hd[:, :, self.scale] = axes * hd[:, None]
        return Carried(h @ scaled.T, hd @ scaled.T, scaled, J_h, J_hd)
