"""The plant's motion, continuous in time: recorded nodes and Hermite interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# Rows: powers 0..5 of the fraction s; columns: x0, h x0', h^2 x0'', x1, h x1', h^2 x1''.
_QUINTIC = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 0.5, 0, 0, 0],
        [-10, -6, -1.5, 10, -4, 0.5],
        [15, 8, 1.5, -15, 7, -1],
        [-6, -3, -0.5, 6, -3, 0.5],
    ]
)
# Rows: powers 0..3; columns: x0, h x0', x1, h x1'.
_CUBIC = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-3, -2, 3, -1], [2, 1, -2, 1]], dtype=np.float64)


class _Place(NamedTuple):
    """Node before a time, fraction of the step from it, step [s]."""

    node: NDArray[np.intp]
    fraction: FloatArray
    step_s: float


class Field(Protocol):
    """Gravity in a freely falling frame: uniform part, and gradient about the centre of mass."""

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the uniform part (k, 3) [m/s^2] and the gradient (k, 3, 3) [1/s^2], in N."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TruthState:
    """True state at the asked times, shape (...) in front. SI units.

    N inertial, B base body; the base origin is the origin of the URDF's root link.
    """

    t_s: FloatArray
    q: FloatArray  # (..., n) joint positions [rad]
    qd: FloatArray  # (..., n)
    qdd: FloatArray  # (..., n)
    tau: FloatArray  # (..., n) joint torques, positive drives the distal side in +q [N m]
    p_NB_N: FloatArray  # (..., 3) base origin [m]
    v_NB_N: FloatArray  # (..., 3) velocity of the base origin, inertial axes [m/s]
    R_NB: FloatArray  # (..., 3, 3)
    q_NB_xyzw: FloatArray  # (..., 4)
    w_NB_B: FloatArray  # (..., 3) [rad/s]
    wd_NB_B: FloatArray  # (..., 3) [rad/s^2]
    a_NB_B: FloatArray  # (..., 3) classical acceleration of the base origin, base axes [m/s^2]
    g_NB_B: FloatArray  # (..., 3) gravity at the base origin, base axes [m/s^2]
    gradient_B: FloatArray  # (..., 3, 3) its gradient, base axes [1/s^2]


@dataclass(frozen=True, eq=False)
class TruthHistory:
    """Nodes of one simulation, equally spaced; MuJoCo's quaternion order (w x y z)."""

    start_s: float
    dt_s: float
    q: FloatArray  # (k, n)
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    p_N: FloatArray  # (k, 3)
    v_N: FloatArray
    a_N: FloatArray
    quat_wxyz: FloatArray  # (k, 4)
    w_B: FloatArray  # (k, 3)
    wd_B: FloatArray
    liquid_m: FloatArray | None = None  # (k, s) displacement along every slide
    field: Field | None = None
    centre_N: FloatArray | None = None  # (k, 3) centre of mass of the whole; with a field

    @property
    def t_s(self) -> FloatArray:
        """Times of the nodes, (k,)."""
        return np.asarray(self.start_s + self.dt_s * np.arange(len(self.q)), dtype=np.float64)

    @property
    def end_s(self) -> float:
        """Time of the last node."""
        return self.start_s + self.dt_s * (len(self.q) - 1)

    @cached_property
    def _slopes(self) -> dict[str, FloatArray]:
        """Time derivatives of the recorded accelerations and torques, by differences."""
        channels = {"tau": self.tau, "qdd": self.qdd, "wd": self.wd_B, "a": self.a_N}
        return {name: _slope(nodes, self.dt_s) for name, nodes in channels.items()}

    @cached_property
    def _quat_rates(self) -> tuple[FloatArray, FloatArray]:
        """First and second derivative of the quaternion from omega and its derivative."""
        first = 0.5 * _times_vector(self.quat_wxyz, self.w_B)
        second = 0.5 * (_times_vector(first, self.w_B) + _times_vector(self.quat_wxyz, self.wd_B))
        return first, second

    def at(self, t_s: ArrayLike) -> TruthState:
        """Evaluate the motion.

        Positions and attitude are quintic Hermite polynomials through position, velocity and
        acceleration of the nodes, velocities cubic ones through velocity and acceleration;
        accelerations and torques cubic ones with slopes from differences. (Second derivatives
        of the quintic would multiply the integrator's error per step by 1 / dt^2.)

        Raises
        ------
        ValueError if a time lies outside the simulated interval.
        """
        t = np.asarray(t_s, dtype=np.float64)
        place = (t - self.start_s) / self.dt_s
        last = len(self.q) - 1
        if t.size and (place.min() < -1e-6 or place.max() > last + 1e-6):
            raise ValueError(
                f"times {t.min()}..{t.max()} s outside the history {self.start_s}..{self.end_s} s"
            )
        i = np.clip(np.floor(place).astype(np.intp), 0, last - 1)
        here = _Place(i, place - i, self.dt_s)
        slope = self._slopes
        quat = _quintic(here, self.quat_wxyz, *self._quat_rates)
        quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
        R = rotation_matrices(quat)
        p_NB_N = _quintic(here, self.p_N, self.v_N, self.a_N)
        g_NB_B, gradient_B = self._gravity(here, t, p_NB_N, R)
        return TruthState(
            t_s=t,
            q=_quintic(here, self.q, self.qd, self.qdd),
            qd=_cubic(here, self.qd, self.qdd),
            qdd=_cubic(here, self.qdd, slope["qdd"]),
            tau=_cubic(here, self.tau, slope["tau"]),
            p_NB_N=p_NB_N,
            v_NB_N=_cubic(here, self.v_N, self.a_N),
            R_NB=R,
            q_NB_xyzw=quat[..., [1, 2, 3, 0]],
            w_NB_B=_cubic(here, self.w_B, self.wd_B),
            wd_NB_B=_cubic(here, self.wd_B, slope["wd"]),
            a_NB_B=np.einsum("...ji,...j->...i", R, _cubic(here, self.a_N, slope["a"])),
            g_NB_B=g_NB_B,
            gradient_B=gradient_B,
        )

    def _gravity(
        self, place: _Place, t: FloatArray, p_NB_N: FloatArray, R_NB: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return gravity at the base origin and its gradient in base axes; zero without a field."""
        if self.field is None or self.centre_N is None:
            return np.zeros((*t.shape, 3)), np.zeros((*t.shape, 3, 3))
        uniform, gradient = self.field.at(t.reshape(-1))
        uniform, gradient = uniform.reshape(*t.shape, 3), gradient.reshape(*t.shape, 3, 3)
        centre = _cubic(place, self.centre_N, _slope(self.centre_N, self.dt_s))
        g_N = uniform + np.einsum("...ij,...j->...i", gradient, p_NB_N - centre)
        g_B = np.einsum("...ji,...j->...i", R_NB, g_N)
        return g_B, np.einsum("...ki,...kl,...lj->...ij", R_NB, gradient, R_NB)


def rotation_matrices(quat_wxyz: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(quat_wxyz, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _times_vector(quat_wxyz: FloatArray, v: FloatArray) -> FloatArray:
    """Quaternion product with the pure quaternion (0, v)."""
    scalar, vector = quat_wxyz[..., :1], quat_wxyz[..., 1:]
    real = -np.sum(vector * v, axis=-1, keepdims=True)
    return np.concatenate([real, scalar * v + np.cross(vector, v)], axis=-1)


def _slope(x: FloatArray, h: float) -> FloatArray:
    """Fourth-order central differences, second order at the two ends."""
    slope = np.gradient(x, h, axis=0, edge_order=2)
    if len(x) > 4:
        slope[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * h)
    return np.asarray(slope, dtype=np.float64)


def _polynomial(s: FloatArray, c: FloatArray) -> FloatArray:
    """Evaluate sum_k c[k] s^k; c (k, ..., m), s (...)."""
    value: FloatArray = c[-1]
    for row in c[-2::-1]:
        value = value * s[..., None] + row
    return value


def _quintic(place: _Place, x: FloatArray, xd: FloatArray, xdd: FloatArray) -> FloatArray:
    """Quintic Hermite polynomial through values and two derivatives at the nodes."""
    i, s, h = place
    j = i + 1
    ends = np.stack([x[i], h * xd[i], h * h * xdd[i], x[j], h * xd[j], h * h * xdd[j]])
    return _polynomial(s, np.tensordot(_QUINTIC, ends, axes=1))


def _cubic(place: _Place, x: FloatArray, xd: FloatArray) -> FloatArray:
    """Cubic Hermite polynomial through values and slopes at the nodes."""
    i, s, h = place
    ends = np.stack([x[i], h * xd[i], x[i + 1], h * xd[i + 1]])
    return _polynomial(s, np.tensordot(_CUBIC, ends, axes=1))
