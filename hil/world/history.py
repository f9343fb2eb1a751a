"""The plant's motion, continuous in time: recorded nodes and Hermite interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

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
    """The node before each of k times, and weights of the derivatives of this node and the next."""

    node: NDArray[np.intp]
    quintic: FloatArray  # (k, 1, 6)
    cubic: FloatArray  # (k, 1, 4)


class Field(Protocol):
    """Gravity in a freely falling frame: a uniform part and a gradient about the centre of mass."""

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the uniform part (k, 3) [m/s^2] and the gradient (k, 3, 3) [1/s^2], in N."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TruthState:
    """True state at the requested times, whose shape is (...). SI units.

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
    gradient_B: FloatArray  # (..., 3, 3) gradient of gravity, base axes [1/s^2]


@dataclass(frozen=True, eq=False)
class TruthHistory:
    """Equally spaced nodes of one simulation, SI units; quaternions in MuJoCo's order w x y z."""

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
    wheel_rad_s: FloatArray | None = None  # (k, w) speed of every wheel relative to the base
    wheel_rad_s2: FloatArray | None = None
    motor_nm: FloatArray | None = None  # (k, w) torque of every wheel's motor on its rotor
    field: Field | None = None
    centre_N: FloatArray | None = None  # (k, 3) centre of mass of the robot; only with a field

    def save(self, path: Path, scenario: str) -> None:
        """Write the nodes and the name of their scenario to a file.

        Raises
        ------
        ValueError for a history with a gravity field.
        """
        if self.field is not None:
            raise ValueError("a history with a field cannot be written")
        kept = {item.name: getattr(self, item.name) for item in fields(self)}
        arrays = {name: value for name, value in kept.items() if value is not None}
        np.savez_compressed(path, scenario=scenario, **arrays)

    @staticmethod
    def load(path: Path) -> tuple[TruthHistory, str]:
        """Read a file of `save`; return the history and the scenario's name.

        Raises
        ------
        OSError, ValueError if the file is not a stored history.
        """
        with np.load(path) as stored:
            given = dict(stored)
        try:
            scenario, start, dt = (given.pop(key).item() for key in ("scenario", "start_s", "dt_s"))
            return TruthHistory(start_s=start, dt_s=dt, **given), str(scenario)
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a truth of this bench: {error}") from error

    @property
    def t_s(self) -> FloatArray:
        """Times of the nodes (k,) [s]."""
        return np.asarray(self.start_s + self.dt_s * np.arange(len(self.q)), dtype=np.float64)

    @property
    def end_s(self) -> float:
        """Time of the last node [s]."""
        return self.start_s + self.dt_s * (len(self.q) - 1)

    @cached_property
    def _quintics(self) -> FloatArray:
        """Return `_pairs` of joint positions, base origin and quaternion with two derivatives."""
        first = 0.5 * _times_vector(self.quat_wxyz, self.w_B)
        second = 0.5 * (_times_vector(first, self.w_B) + _times_vector(self.quat_wxyz, self.wd_B))
        return _pairs(
            np.hstack([self.q, self.p_N, self.quat_wxyz]),
            self.dt_s * np.hstack([self.qd, self.v_N, first]),
            self.dt_s**2 * np.hstack([self.qdd, self.a_N, second]),
        )

    @cached_property
    def _cubics(self) -> FloatArray:
        """Return `_pairs` of all other channels and their slopes (differences if not stored)."""
        centre = np.empty((len(self.q), 0)) if self.centre_N is None else self.centre_N
        by_differences = np.hstack([self.qdd, self.tau, self.wd_B, self.a_N, centre])
        slopes = [self.qdd, self.a_N, self.wd_B, slope(by_differences, self.dt_s)]
        return _pairs(
            np.hstack([self.qd, self.v_N, self.w_B, by_differences]),
            self.dt_s * np.hstack(slopes),
        )

    def at(self, t_s: ArrayLike) -> TruthState:
        """Return the state at the times `t_s` [s].

        Positions and attitude are quintic Hermite polynomials through position, velocity and
        acceleration of the nodes. Velocities are cubic through velocity and acceleration;
        accelerations and torques are cubic with slopes from differences. (Second derivatives
        of the quintic would multiply the integrator's error per step by 1 / dt^2.)

        Raises
        ------
        ValueError if a time lies outside the simulated interval.
        """
        t = np.asarray(t_s, dtype=np.float64)
        place = self._place(t.reshape(-1))
        n, shape = self.q.shape[1], t.shape
        quintic = (place.quintic @ self._quintics[place.node]).reshape(*shape, -1)
        cubic = (place.cubic @ self._cubics[place.node]).reshape(*shape, -1)
        q, p_NB_N, quat = np.split(quintic, [n, n + 3], axis=-1)
        parts = np.cumsum([n, 3, 3, n, n, 3, 3])
        qd, v_NB_N, w_NB_B, qdd, tau, wd_NB_B, a_N, centre = np.split(cubic, parts, axis=-1)
        quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
        R = rotation_matrices(quat)
        g_NB_B, gradient_B = self._gravity(t, p_NB_N - centre if centre.size else p_NB_N, R)
        return TruthState(
            t_s=t,
            q=q,
            qd=qd,
            qdd=qdd,
            tau=tau,
            p_NB_N=p_NB_N,
            v_NB_N=v_NB_N,
            R_NB=R,
            q_NB_xyzw=quat[..., [1, 2, 3, 0]],
            w_NB_B=w_NB_B,
            wd_NB_B=wd_NB_B,
            a_NB_B=(a_N[..., None, :] @ R)[..., 0, :],
            g_NB_B=g_NB_B,
            gradient_B=gradient_B,
        )

    @cached_property
    def _wheels(self) -> tuple[CubicHermiteSpline, CubicHermiteSpline]:
        if self.wheel_rad_s is None or self.wheel_rad_s2 is None or self.motor_nm is None:
            raise ValueError("the robot of this history has no wheels")
        torque_slope = slope(self.motor_nm, self.dt_s)
        return (
            CubicHermiteSpline(self.t_s, self.wheel_rad_s, self.wheel_rad_s2),
            CubicHermiteSpline(self.t_s, self.motor_nm, torque_slope),
        )

    def wheels_at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return speed [rad/s] and motor torque [N m] (w,) of every wheel; constant past the ends.

        Raises
        ------
        ValueError for a robot without wheels.
        """
        speed, torque = self._wheels
        t = min(max(t_s, self.start_s), self.end_s)
        return np.asarray(speed(t)), np.asarray(torque(t))

    def _place(self, t: FloatArray) -> _Place:
        steps = (t - self.start_s) / self.dt_s
        last = len(self.q) - 1
        if t.size and (steps.min() < -1e-6 or steps.max() > last + 1e-6):
            raise ValueError(
                f"times {t.min()}..{t.max()} s outside the history {self.start_s}..{self.end_s} s"
            )
        node = np.clip(np.floor(steps).astype(np.intp), 0, last - 1)
        powers = (steps - node)[:, None, None] ** np.arange(6)
        return _Place(node, powers @ _QUINTIC, powers[..., :4] @ _CUBIC)

    def _gravity(
        self, t: FloatArray, from_centre_N: FloatArray, R_NB: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return gravity at the base origin and its gradient in base axes; zero without a field."""
        if self.field is None or self.centre_N is None:
            return np.zeros((*t.shape, 3)), np.zeros((*t.shape, 3, 3))
        uniform, gradient = self.field.at(t.reshape(-1))
        uniform, gradient = uniform.reshape(*t.shape, 3), gradient.reshape(*t.shape, 3, 3)
        g_N = uniform + np.einsum("...ij,...j->...i", gradient, from_centre_N)
        g_B = np.einsum("...ji,...j->...i", R_NB, g_N)
        return g_B, np.einsum("...ki,...kl,...lj->...ij", R_NB, gradient, R_NB)


def _pairs(*derivatives: FloatArray) -> FloatArray:
    """Return d derivatives (k, m) of every node and of the next node, as a view (k - 1, 2 d, m).

    The derivatives of both nodes are adjacent in memory.
    """
    nodes = np.stack(derivatives, axis=1)
    count, d, m = nodes.shape
    return np.lib.stride_tricks.as_strided(
        nodes, (count - 1, 2 * d, m), nodes.strides, writeable=False
    )


def rotation_matrices(quat_wxyz: FloatArray) -> FloatArray:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(quat_wxyz, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _times_vector(quat_wxyz: FloatArray, v: FloatArray) -> FloatArray:
    """Return the quaternion product with the pure quaternion (0, v)."""
    scalar, vector = quat_wxyz[..., :1], quat_wxyz[..., 1:]
    real = -np.sum(vector * v, axis=-1, keepdims=True)
    return np.concatenate([real, scalar * v + np.cross(vector, v)], axis=-1)


def slope(x: FloatArray, h: float) -> FloatArray:
    """Return the derivative of x (k, ...) by central differences of fourth order; step h.

    The two nodes at each end have second order.
    """
    slope = np.gradient(x, h, axis=0, edge_order=2)
    if len(x) > 4:
        slope[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * h)
    return np.asarray(slope, dtype=np.float64)
