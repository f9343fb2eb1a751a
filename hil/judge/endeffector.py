"""End-effector error: difference of the tool's paths in a wrong and in the true model.

The same joint motion drives two models from one base pose with zero momentum; the base velocity is
nu_b = -H_bb^-1 H_bm qd. In base axes nu_b does not depend on the base pose. Therefore nu_b is
computed for all parameter draws at once, and integrated on SE(3) by the fourth-order Magnus rule.
Source: the end-effector error of Rackl, Lampariello, Albu-Schaeffer (2013), eq. (30); definition of
the error in README.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.judge.floating import FloatingRobot
from hil.world.inertia import FloatArray

Motion = Callable[[FloatArray], tuple[FloatArray, FloatArray]]  # times (k,) -> q, qd (k, n)
CHUNK = 200_000  # 6 x 6 systems solved at once: 60 MB


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolError:
    """Error of the tool pose over time [m, rad]; arrays (draws, steps + 1)."""

    t_s: FloatArray
    position_m: FloatArray
    angle_rad: FloatArray

    def summary(self) -> dict[str, float]:
        """Return mean and maximum over time, each averaged over the draws."""
        return {
            "mean_position_m": float(self.position_m.mean()),
            "max_position_m": float(self.position_m.max(axis=1).mean()),
            "mean_angle_rad": float(self.angle_rad.mean()),
            "max_angle_rad": float(self.angle_rad.max(axis=1).mean()),
        }


class Verification:
    """A verification trajectory prepared for any number of parameter vectors.

    Parameters
    ----------
    robot : the model, whose unknown bodies' parameters are varied
    motion : joint positions and velocities at given times [rad, rad/s]
    duration_s : length of the trajectory [s]
    rate_hz : integration steps per second; each costs two evaluations
    """

    def __init__(
        self, robot: FloatingRobot, motion: Motion, duration_s: float, rate_hz: float = 10.0
    ) -> None:
        self._steps = max(1, round(duration_s * rate_hz))
        self._step_s = duration_s / self._steps
        times = np.linspace(0.0, duration_s, 2 * self._steps + 1)
        q, qd = motion(times)
        H, h, H0, h0 = [], [], [], []
        for k in range(len(times)):
            columns = robot.mass_columns(q[k])[:6]
            momentum = robot.momentum(q[k], qd[k])
            H.append(columns @ robot.select)
            H0.append(columns @ robot.known)
            h.append(momentum @ robot.select)
            h0.append(momentum @ robot.known)
        self._H, self._h = np.array(H), np.array(h)
        self._H0, self._h0 = np.array(H0), np.array(h0)
        poses = [robot.tool_pose(row) for row in q[::2]]
        self._R_BE = np.array([R for R, _ in poses])
        self._p_BE = np.array([p for _, p in poses])
        self.t_s: FloatArray = times[::2]

    def base_velocity(self, x: FloatArray) -> FloatArray:
        """Return nu_b (evaluations, draws, 6) [m/s, rad/s] in base axes of draws x (draws, p)."""
        nu = np.empty((len(self._H), len(x), 6))
        block = max(1, CHUNK // len(x))
        for first in range(0, len(nu), block):
            part = slice(first, first + block)
            H = self._H0[part, None] + np.einsum("tijp,dp->tdij", self._H[part], x)
            h = self._h0[part, None] + np.einsum("tip,dp->tdi", self._h[part], x)
            nu[part] = np.linalg.solve(H, -h[..., None])[..., 0]
        return nu

    def tool_path(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return R_NE (draws, steps+1, 3, 3), p_NE_N (draws, steps+1, 3); the base starts at N."""
        nu = self.base_velocity(np.atleast_2d(x))
        steps = exponential(_magnus(nu, self._step_s))
        draws = nu.shape[1]
        R, p = np.broadcast_to(np.eye(3), (draws, 3, 3)), np.zeros((draws, 3))
        rotations, places = [], []
        for k in range(self._steps + 1):
            if k:
                dR, dp = steps[0][k - 1], steps[1][k - 1]
                p = p + (R @ dp[..., None])[..., 0]
                R = R @ dR
            rotations.append(R @ self._R_BE[k])
            places.append(p + R @ self._p_BE[k])
        return np.stack(rotations, axis=1), np.stack(places, axis=1)

    def error(self, x: FloatArray, truth: FloatArray) -> ToolError:
        """Return the tool's error of the parameters x (draws, p) or (p,) against the truth (p,)."""
        R_true, p_true = self.tool_path(truth)
        R, p = self.tool_path(x)
        relative = np.swapaxes(R_true, -1, -2) @ R
        return ToolError(
            t_s=self.t_s,
            position_m=np.linalg.norm(p - p_true, axis=-1),
            angle_rad=rotation_angle(relative),
        )


def rotation_angle(R: FloatArray) -> FloatArray:
    """Return the angle [rad] of rotation matrices (..., 3, 3), accurate near zero too."""
    axis = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(axis, axis=-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.arctan2(sine, cosine))


def exponential(twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation (..., 3, 3) and translation (..., 3) of exp of twists [v, w] (..., 6)."""
    v, w = twist[..., :3], twist[..., 3:]
    angle2 = np.sum(w * w, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(small, 1 / 6 - angle2 / 120, (safe - np.sin(safe)) / safe**3)
    W = _skew(w)
    W2 = W @ W
    eye = np.eye(3)
    translation = (eye + b * W + c * W2) @ v[..., None]
    return eye + a * W + b * W2, translation[..., 0]


def _magnus(nu: FloatArray, step_s: float) -> FloatArray:
    """Return one twist per step from the velocities at its start, middle and end (Simpson's rule).

    Body velocities multiply on the right, X' = X nu^, hence the sign of the commutator:
    Omega = h/6 (n0 + 4 n1 + n2) + h^2/12 [n0, n2]. Source: Iserles et al. (2000), sec. 5.
    """
    n0, n1, n2 = nu[:-2:2], nu[1:-1:2], nu[2::2]
    return np.asarray(step_s / 6 * (n0 + 4 * n1 + n2) + step_s**2 / 12 * _bracket(n0, n2))


def _bracket(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the Lie bracket of twists [v, w] (..., 6)."""
    va, wa, vb, wb = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    return np.concatenate((np.cross(wa, vb) - np.cross(wb, va), np.cross(wa, wb)), axis=-1)


def _skew(w: FloatArray) -> FloatArray:
    S = np.zeros((*w.shape[:-1], 3, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    S[..., 1, 0], S[..., 2, 0], S[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return S
