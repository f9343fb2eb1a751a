"""Poses of base and joints over time, from the blocks of a recording or from a planned motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from planner.attitude import attitudes
from planner.spline import Trajectory

MOST_KEYS = 3000  # most instants of a scene; longer motions are thinned
PLAN_RATE_HZ = 20.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Poses at m instants; along free directions the system's centre of mass is N's origin."""

    t_s: FloatArray  # (m,)
    q_rad: FloatArray  # (m, n) in the model's order
    R_NB: FloatArray  # (m, 3, 3)
    p_NB_m: FloatArray  # (m, 3) origin of the base, in N
    attitude: str  # source of R_NB, in words


def recorded(blocks: Sequence[Block], problem: Problem, pi: FloatArray, start_ns: int) -> Motion:
    """Return the motion at the nodes of blocks; attitude from the tracker, else from the rate.

    Parameters
    ----------
    pi : (10 (n + 1),) inertial parameters of base and links, including the bodies they carry
    """
    t_ns, first = np.unique(np.concatenate([b.t_ns for b in blocks]), return_index=True)
    q = np.concatenate([b.q_rad for b in blocks])[first]
    w = np.concatenate([b.w_NB_B_rad_s for b in blocks])[first]
    is_known = np.concatenate([np.full(len(b.t_ns), b.has_attitude) for b in blocks])[first]
    t_s = (t_ns - start_ns) * 1e-9
    if is_known.sum() > 1:
        R_known = Rotation.from_matrix(np.concatenate([b.R_NB for b in blocks])[first][is_known])
        inside = np.clip(t_s, t_s[is_known][0], t_s[is_known][-1])
        R, source = Slerp(t_s[is_known], R_known)(inside).as_matrix(), "by the star tracker"
    elif problem.freedom.size:
        steps = attitudes(0.5 * (w[1:] + w[:-1]), np.diff(t_s)[:, None])
        R, source = np.concatenate([np.eye(3)[None], steps]), "the integral of the measured rate"
    else:
        R, source = np.tile(np.eye(3), (len(t_s), 1, 1)), "held"
    thin = slice(None, None, -(-len(t_s) // MOST_KEYS))
    return _placed(t_s[thin], q[thin], R[thin], problem, pi, source)


def planned(trajectory: Trajectory, problem: Problem, pi: FloatArray) -> Motion:
    """Return a planned motion; the base reacts to the arm so that the momentum stays zero."""
    count = min(round(trajectory.duration_s * PLAN_RATE_HZ), MOST_KEYS)
    step_s = trajectory.duration_s / count
    t_s = step_s * np.arange(count + 1, dtype=np.float64)
    q_mid, qd_mid, *_ = trajectory.evaluate(t_s[:-1] + 0.5 * step_s)
    problem.model.set_parameters(pi)
    H, S = problem.model.mass_matrices(q_mid), problem.freedom
    pushed = S.T @ H[:, :6, 6:] @ qd_mid[..., None]
    base = -S @ np.linalg.solve(S.T @ H[:, :6, :6] @ S, pushed)
    R = np.concatenate([np.eye(3)[None], attitudes(base[:, 3:, 0], step_s)])
    source = "that of a system without momentum"
    return _placed(t_s, trajectory.evaluate(t_s)[0], R, problem, pi, source)


def _placed(
    t_s: FloatArray, q: FloatArray, R: FloatArray, problem: Problem, pi: FloatArray, source: str
) -> Motion:
    whole = problem.model.composites(q) @ pi
    com_N = np.einsum("kij,kj->ki", R, whole[:, 1:4] / whole[:, :1])
    free = problem.freedom[:3] @ problem.freedom[:3].T  # projects on directions free to move
    return Motion(t_s=t_s, q_rad=q, R_NB=R, p_NB_m=-com_N @ free, attitude=source)
