"""External moments that change the angular momentum: gravity gradient, wrenches, switched forces.

The gyro channel depends on the momentum, so a moment acts on it through its integral. The integral
is carried from block to block by Gauss quadrature over the nodes, with its exact Jacobian.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.polynomial import legendre

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


def _nothing() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Impulse:
    """State at the end of a block, for the next: momentum gained in N, modes, joints' motion."""

    end_ns: int
    L_Nms: FloatArray  # (3,)
    J: FloatArray  # (3, p) its derivative by the state
    x: FloatArray  # (p,) the state it was evaluated at
    fired_s: FloatArray | float = 0.0  # (K,) integral of the switched forces' shares up to then
    modes: FloatArray = field(default_factory=_nothing)  # (2 c,) coordinates, then rates
    J_modes: FloatArray = field(default_factory=_nothing)  # (2 c, p)
    doubt: FloatArray = field(default_factory=_nothing)  # (2 c,) variance not due to the state
    motion: FloatArray = field(default_factory=_nothing)  # (2 n,) of the joints; see `continuity`
    J_motion: FloatArray = field(default_factory=_nothing)  # (2 n, p)
    cov_motion: FloatArray = field(default_factory=_nothing)  # (2 n, 2 n)

    def at(self, x: FloatArray) -> FloatArray:
        """Return the momentum (3,) at another state, to first order."""
        momentum: FloatArray = self.L_Nms + self.J @ (x - self.x)
        return momentum

    def modes_at(self, x: FloatArray) -> FloatArray:
        """Return the modes (2 c,) at another state, to first order."""
        modes: FloatArray = self.modes + self.J_modes @ (x - self.x)
        return modes

    def motion_at(self, x: FloatArray) -> FloatArray:
        """Return the joints' positions and rates (2 n,) at another state, to first order."""
        motion: FloatArray = self.motion + self.J_motion @ (x - self.x)
        return motion

    def without_motion(self) -> Self:
        """Return a copy without the joints' motion, as after a block that is not used."""
        nothing = _nothing()
        return replace(self, motion=nothing, J_motion=nothing, cov_motion=nothing)


@lru_cache(maxsize=8)
def integration(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return the integration matrix (m, m) and the weights (m,) of Gauss quadrature on [-1, 1].

    The matrix maps values at the m nodes to the interpolant's integrals from -1 to each node.
    """
    points, weights = legendre.leggauss(nodes)
    to_coefficients = np.linalg.solve(legendre.legvander(points, nodes - 1), np.eye(nodes))
    rows = np.empty((nodes, nodes))
    for k in range(nodes):
        integral = legendre.legint(np.eye(nodes)[k], lbnd=-1)
        rows[:, k] = legendre.legval(points, integral)
    return rows @ to_coefficients, weights


def span_ns(block: Block, window_s: float) -> tuple[int, int]:
    """Return start and end of a block's window [ns]."""
    centre_ns = (int(block.t_ns[0]) + int(block.t_ns[-1])) // 2
    half_ns = round(0.5e9 * window_s)
    return centre_ns - half_ns, centre_ns + half_ns


def needed(problem: Problem) -> bool:
    """Return whether anything in this problem changes the momentum."""
    return problem.orbit is not None or pulled(problem)


def pulled(problem: Problem) -> bool:
    """Return whether there are switched forces, or an external wrench is estimated."""
    return problem.has("wrench") or problem.has("target_wrench") or len(problem.switched) > 0


def momentum_at_nodes(
    block: Block, x: FloatArray, problem: Problem, G: FloatArray, before: Impulse | None
) -> tuple[FloatArray, FloatArray, Impulse]:
    """Return the momentum gained in N at the nodes (m, 3), its Jacobian (m, 3, p), and the impulse.

    The impulse is that at the end of the block. `G` (m, 3, 3) is the gravity-gradient field in base
    axes. A gap since `before` is bridged with the moment at this block's first node.
    """
    W, J_W = _wrench(block, x, problem, G)
    centres = _centres(block, x, problem)
    T, J = _about(centres, block, problem, W, J_W)
    cumulative, weights = integration(len(T))
    half_s = 0.5 * problem.window_s
    start_ns, stop_ns = span_ns(block, problem.window_s)
    if before is None:
        before = Impulse(start_ns, np.zeros(3), np.zeros((3, len(x))), x)
    gap_s = max(0, start_ns - before.end_ns) * 1e-9
    L0, J0 = before.at(x) + gap_s * T[0], before.J + gap_s * J[0]
    L = L0 + half_s * cumulative @ T
    J_L = J0 + half_s * np.einsum("ij,jkp->ikp", cumulative, J)
    L_end, J_end = L0 + half_s * weights @ T, J0 + half_s * np.einsum("j,jkp->kp", weights, J)
    fired_s: FloatArray | float = 0.0
    if len(problem.switched):
        fired = problem.switched.profile(block, x)
        by_gap = np.zeros((3, 1, len(problem.switched)))
        if gap_s > 0.0:
            by_gap[0] = fired.before_s - before.fired_s
        dL, dJ = _about(centres, block, problem, *problem.switched.wrench(fired.U_s + by_gap, x))
        L, J_L = L + dL, J_L + dJ
        gained = np.repeat(by_gap + fired.whole_s[:, None], len(T), axis=1)
        dL, dJ = _about(centres, block, problem, *problem.switched.wrench(gained, x))
        L_end, J_end = L_end + dL.mean(axis=0), J_end + dJ.mean(axis=0)
        fired_s = fired.before_s + fired.whole_s[0]
    return L, J_L, Impulse(stop_ns, L_end, J_end, x, fired_s)


def _wrench(
    block: Block, x: FloatArray, problem: Problem, G: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return external force and moment in B (m, 6) without switched forces, and d/dx (m, 6, p)."""
    m, model = len(block.t_ns), problem.model
    pi = problem.pi(x)
    W, J = np.zeros((m, 6)), np.zeros((m, 6, len(x)))
    if G.any():
        rows = model.field_regressors(block.q_rad, G)[:, :6]
        W, J[:, :, problem.inertial] = rows @ pi, rows @ problem.U
    if problem.has("wrench") or problem.has("target_wrench"):
        value, by_state = constant_force(block, x, problem)
        W, J = W + value[:, :6], J + by_state[:, :6]
    return W, J


def _centres(block: Block, x: FloatArray, problem: Problem) -> list[tuple[FloatArray, FloatArray]]:
    """Return the centre of mass of the whole (3,) at every node, in B, and its Jacobian (3, k)."""
    pi, found = problem.pi(x), []
    for whole in problem.model.composites(block.q_rad):
        total, J_total = whole @ pi, whole @ problem.U
        mass, h = total[0], total[1:4]
        c = h / mass
        found.append((c, (J_total[1:4] - np.outer(c, J_total[0])) / mass))
    return found


def _about(
    centres: list[tuple[FloatArray, FloatArray]],
    block: Block,
    problem: Problem,
    W: FloatArray,
    J_W: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the moment about the centres, in N (m, 3), and its Jacobian.

    `W` (m, 6): force and moment about the base's origin in base axes; `J_W` (m, 6, p).
    """
    m, p = len(W), J_W.shape[2]
    T, J = np.zeros((m, 3)), np.zeros((m, 3, p))
    for i, (c, J_c) in enumerate(centres):
        R, force = block.R_NB[i], W[i, :3]
        T[i] = R @ (W[i, 3:] - cross(c, force))
        J_moment = J_W[i, 3:] - skew(c) @ J_W[i, :3]
        J_moment[:, problem.inertial] += skew(force) @ J_c
        J[i] = R @ J_moment
    return T, J


def external_force(
    block: Block | BlockStack, x: FloatArray, problem: Problem
) -> tuple[FloatArray, FloatArray]:
    """Return the generalised force of all wrenches at the nodes (m, R), and d/dx.

    Rows: as `RobotModel`, those of the base about its origin in base axes; the Jacobian is
    (m, R, p). See `constant_force` and `Switched`.
    """
    value, J = constant_force(block, x, problem)
    if len(problem.switched):
        blocks = block.blocks if isinstance(block, BlockStack) else (block,)
        u = np.concatenate([problem.switched.profile(own, x).u for own in blocks], axis=1)
        own, by_state = problem.switched.wrench(u, x)
        value[:, :6] += own
        J[:, :6] += by_state
    return value, J


def constant_force(
    block: Block | BlockStack, x: FloatArray, problem: Problem
) -> tuple[FloatArray, FloatArray]:
    """Return the generalised force of the constant wrenches at the nodes (m, R), and d/dx.

    Rows: as `RobotModel`, those of the base about its origin in base axes; the Jacobian is
    (m, R, p). A wrench on the target acts through the Jacobian of the target's centre of mass as
    estimated at x. This point's own derivative, of the size of the force, is left out. One part of
    the force is constant in inertial axes and one in the target's: air pushes along the wind, and
    sideways by the attitude of the faces.
    """
    m = len(block.q_rad)
    J = np.zeros((m, 6 + len(problem.model.torque_units), len(x)))
    R = np.zeros((m, 6, 6))
    R[:, :3, :3] = R[:, 3:, 3:] = block.R_NB.transpose(0, 2, 1)
    if problem.has("wrench"):
        J[:, :6, problem.at("wrench")] = R
    if problem.has("target_wrench"):
        centre_m = _target_com(x, problem)
        for i in range(m):
            at, R_BE = problem.model.point_jacobian(block.q_rad[i], centre_m)
            ways = np.concatenate([R[i], np.vstack([R_BE, np.zeros((3, 3))])], axis=1)
            J[i, :, problem.at("target_wrench")] = at.T @ ways
    return J @ x, J


def _target_com(x: FloatArray, problem: Problem) -> FloatArray:
    """Return the target's centre of mass in E (3,) [m], by the state or as configured."""
    if "target" in problem.unknown:
        own = x[problem.body("target")]
        if own[0] > 0:
            return np.asarray(own[1:4] / own[0])
    return problem.target_com_m
