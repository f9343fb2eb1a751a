"""Per-sample CasADi functions of joint motion: limits, whitened information rows, torque regressor.

At zero momentum the base's motion is algebraic in (q, qd, qdd), as in `measurement/fused.py`:

    nu  = -H_bb^-1 H_bm qd,   a_b = -H_bb^-1 (c_b + H_bm qdd),   tau = c_m + H_bm^T a_b + H_m qdd
    J_nu = -H_bb^-1 Y_h,      J_a = -H_bb^-1 (Y_b + C_b J_w),     J_tau = Y_m + H_bm^T J_a + C_m J_w

so the only differential equation left is that of the base's attitude, a quadrature of w. CasADi's
algorithmic differentiation gives all derivatives by q, qd, qdd.
"""

from dataclasses import dataclass

import casadi as ca

from fsw.estimators.model.inertia import PARAMETERS
from fsw.messages import FloatArray
from planner.chain import (
    Geometry,
    Pose,
    all_parameters,
    body_columns,
    carried_momentum,
    force_cross,
    motion_cross,
    pose,
    spatial_inertia,
    velocities,
)
from planner.noise import NoiseModel

MOTION_OUTPUTS = 12  # base's w and wd, tool's position, base's acceleration; three each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kernel:
    """CasADi functions of one sample with arguments (q, qd, qdd, x); x is the unknown bodies' pi.

    Attributes
    ----------
    motion : -> g (n + 12,): torque, w_NB_B, wd_NB_B, p_BE_B, a_NB_B of the base's origin
    motion_jacobian : -> g, (n + 12, 3 n) its derivative by [q; qd; qdd]
    information : -> X (r, s): whitened rows of the state for one second of data
    information_adjoint : with a fifth argument, the seed of X -> gradient by [q; qd; qdd] (3 n,)
    regressor : -> [J_tau (n, p), tau (n,)], unweighted
    regressor_adjoint : with two more arguments, the seeds of J_tau and tau -> gradient (3 n,)
    predictions : -> [tau; f; w] (n + 6,), [J_tau; J_f; J_w] (n + 6, p)
    signals : -> [tau; f; w] (n + 6,)
    """

    n: int
    states: int
    motion: ca.Function
    motion_jacobian: ca.Function
    information: ca.Function
    information_adjoint: ca.Function
    regressor: ca.Function
    regressor_adjoint: ca.Function
    predictions: ca.Function
    signals: ca.Function


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sample:
    """Expressions at one sample."""

    tau: ca.SX
    w: ca.SX
    a: ca.SX  # (6,) base acceleration
    p_tool: ca.SX
    H_bb: ca.SX  # Cholesky factor of H_bb
    H_bm: ca.SX
    Y_h: ca.SX  # (6, p)
    Y: ca.SX  # (6 + n, p)
    C_w: ca.SX  # (6 + n, 3)


def build_kernel(
    arm: Geometry,
    unknown: tuple[str, ...],
    known_base: FloatArray,
    known_target: FloatArray | None,
    noise: NoiseModel,
) -> Kernel:
    """Build the functions for the unknown bodies; the known ones have fixed parameters (10,)."""
    n, p = len(arm.axis), PARAMETERS * len(unknown)
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    x = ca.SX.sym("x", p)
    base = x[:PARAMETERS] if "base" in unknown else ca.SX(known_base)
    target = x[-PARAMETERS:] if "target" in unknown else None
    if target is None and known_target is not None:
        target = ca.SX(known_target)
    s = _sample(arm, unknown, base, target, (q, qd, qdd))
    inputs = [q, qd, qdd, x]
    motion = ca.vertcat(q, qd, qdd)
    g = ca.vertcat(s.tau, s.w, s.a[3:], s.p_tool, s.a[:3])
    y, J = _rows(s, noise)
    X = _whitened(J, noise, s)
    J_tau = J[:n, :]
    return Kernel(
        n=n,
        states=X.shape[1],
        motion=ca.Function("motion", inputs, [g]),
        motion_jacobian=ca.Function("motion_jacobian", inputs, [g, ca.jacobian(g, motion)]),
        information=ca.Function("information", inputs, [X]),
        information_adjoint=_adjoint("information_adjoint", inputs, motion, [X]),
        regressor=ca.Function("regressor", inputs, [J_tau, s.tau]),
        regressor_adjoint=_adjoint("regressor_adjoint", inputs, motion, [J_tau, s.tau]),
        predictions=ca.Function("predictions", inputs, [y, J]),
        signals=ca.Function("signals", inputs, [y]),
    )


def _adjoint(name: str, inputs: list[ca.SX], motion: ca.SX, outputs: list[ca.SX]) -> ca.Function:
    seeds = [ca.SX.sym(f"seed{k}", *out.shape) for k, out in enumerate(outputs)]
    flat = ca.vertcat(*[ca.vec(ca.densify(out)) for out in outputs])
    seed = ca.vertcat(*[ca.vec(s) for s in seeds])
    return ca.Function(name, [*inputs, *seeds], [ca.jtimes(flat, motion, seed, True)])


def _sample(
    arm: Geometry,
    unknown: tuple[str, ...],
    base: ca.SX,
    target: ca.SX | None,
    motion: tuple[ca.SX, ca.SX, ca.SX],
) -> _Sample:
    q, qd, qdd = motion
    n = len(arm.axis)
    at = pose(arm, q)
    bodies = all_parameters(arm, base, target)
    frames = [(at.R[k], at.p[k]) for k in range(n + 1)]
    if target is not None:
        frames.append((at.R_tool, at.p_tool))
    M = [spatial_inertia(pi, *frame) for pi, frame in zip(bodies, frames, strict=True)]
    if target is not None:
        M[arm.tool_body] = M[arm.tool_body] + M.pop()
    H_bb, H_bm = _mass_matrix(M, at)
    root = cholesky(H_bb)
    nu = -solve(root, H_bm @ qd)
    forces, C_w, V, A = _bias_forces(at, M, (nu[3:], qd, qdd))
    a = -solve(root, forces[:6])
    tau = forces[6:] + H_bm.T @ a
    columns, momenta = [], []
    if "base" in unknown:
        Y_0 = body_columns(V[0], a, *frames[0])
        columns.append(ca.vertcat(Y_0, ca.SX(n, PARAMETERS)))
        momenta.append(carried_momentum(nu, *frames[0]))
    if "target" in unknown:
        held = arm.tool_body
        Y_t = body_columns(V[held], A[held] + a, *frames[-1])
        moved = at.ancestors(held)
        S = [at.S[k] if k in moved else ca.SX(6, 1) for k in range(n)]
        columns.append(ca.vertcat(Y_t, ca.horzcat(*S).T @ Y_t))
        momenta.append(carried_momentum(nu + V[held] - V[0], *frames[-1]))
    return _Sample(
        tau=tau,
        w=nu[3:],
        a=a,
        p_tool=at.p_tool,
        H_bb=root,
        H_bm=H_bm,
        Y_h=ca.horzcat(*momenta),
        Y=ca.horzcat(*columns),
        C_w=C_w,
    )


def _mass_matrix(M: list[ca.SX], at: Pose) -> tuple[ca.SX, ca.SX]:
    """Return H_bb and H_bm from the bodies' inertias by composite sums (CRBA)."""
    n, composite = len(at.S), list(M)
    columns: list[ca.SX] = []
    for k in range(n - 1, -1, -1):
        F = composite[k + 1] @ at.S[k]
        columns.insert(0, F)
        parent = at.parents[k]
        composite[parent] = composite[parent] + composite[k + 1]
    return composite[0], ca.horzcat(*columns)


def _bias_forces(
    at: Pose, M: list[ca.SX], motion: tuple[ca.SX, ca.SX, ca.SX]
) -> tuple[ca.SX, ca.SX, list[ca.SX], list[ca.SX]]:
    """Return generalised forces (6 + n) at zero base acceleration, d/dw, velocities, accelerations.

    A change e of w adds [0; e] to every velocity and [0; e] x (V_k - V_0) to every acceleration.
    """
    w, qd, qdd = motion
    n = len(at.S)
    V, A = velocities(at, w, qd)
    for body in range(1, n + 1):
        for k in reversed(at.ancestors(body)):
            A[body] = A[body] + at.S[k] * qdd[k]
    wrenches = []
    for k in range(n + 1):
        h = M[k] @ V[k]
        columns = [M[k] @ A[k] + force_cross(V[k], h)]
        for axis in range(3):
            E = ca.SX(6, 1)
            E[3 + axis] = 1
            change = M[k] @ motion_cross(E, V[k] - V[0])
            columns.append(change + force_cross(E, h) + force_cross(V[k], M[k][:, 3 + axis]))
        wrenches.append(ca.horzcat(*columns))
    joints: list[ca.SX] = []
    for k in range(n - 1, -1, -1):
        joints.insert(0, at.S[k].T @ wrenches[k + 1])
        wrenches[at.parents[k]] = wrenches[at.parents[k]] + wrenches[k + 1]
    stacked = ca.vertcat(wrenches[0], *joints)
    return stacked[:, 0], stacked[:, 1:], V, A


def _rows(s: _Sample, noise: NoiseModel) -> tuple[ca.SX, ca.SX]:
    """Return predictions [tau; f; w] and their Jacobian by x."""
    r = ca.SX(noise.p_BS_m)
    R = ca.skew(r)
    J_nu = -solve(s.H_bb, s.Y_h)
    J_w = J_nu[3:, :]
    J_a = -solve(s.H_bb, s.Y[:6, :] + s.C_w[:6, :] @ J_w)
    J_tau = s.Y[6:, :] + s.H_bm.T @ J_a + s.C_w[6:, :] @ J_w
    centripetal = -ca.skew(ca.cross(s.w, r)) - ca.skew(s.w) @ R
    J_f = J_a[:3, :] - R @ J_a[3:, :] + centripetal @ J_w
    f = s.a[:3] + ca.cross(s.a[3:], r) + ca.cross(s.w, ca.cross(s.w, r))
    return ca.vertcat(s.tau, f, s.w), ca.vertcat(J_tau, J_f, J_w)


def _whitened(J: ca.SX, noise: NoiseModel, s: _Sample) -> ca.SX:
    """Return [J, nuisance columns] whitened by the sensors' white noise."""
    n = s.tau.shape[0]
    columns = [J]
    if noise.torque_offset:
        columns.append(ca.vertcat(ca.SX.eye(n), ca.SX(6, n)))
    if noise.acc_bias:
        columns.append(ca.vertcat(ca.SX(n, 3), ca.SX.eye(3), ca.SX(3, 3)))
    if noise.gyro_bias:
        columns.append(ca.vertcat(ca.SX(n + 3, 3), ca.SX.eye(3)))
    if noise.momentum:
        columns.append(_momentum_columns(s, ca.SX(noise.p_BS_m)))
    if noise.torque_scale:
        columns.append(ca.vertcat(ca.diag(s.tau), ca.SX(6, n)))
    return ca.diag(ca.SX(noise.white**-0.5)) @ ca.horzcat(*columns)


def _momentum_columns(s: _Sample, r: ca.SX) -> ca.SX:
    """Return d[tau; f; w]/d L of a residual angular momentum L, at the attitude of the start.

    The attitude changes only the direction of L in B, and the limit on the base's attitude bounds
    this change.
    """
    J_w = solve(s.H_bb, ca.vertcat(ca.SX(3, 3), ca.SX.eye(3)))[3:, :]
    J_a = -solve(s.H_bb, s.C_w[:6, :] @ J_w)
    centripetal = -ca.skew(ca.cross(s.w, r)) - ca.skew(s.w) @ ca.skew(r)
    J_f = J_a[:3, :] - ca.skew(r) @ J_a[3:, :] + centripetal @ J_w
    return ca.vertcat(s.H_bm.T @ J_a + s.C_w[6:, :] @ J_w, J_f, J_w)


def cholesky(A: ca.SX) -> ca.SX:
    """Return the lower factor of a symmetric positive definite matrix, entry by entry."""
    n = A.shape[0]
    L = ca.SX(n, n)
    for j in range(n):
        L[j, j] = ca.sqrt(A[j, j] - ca.dot(L[j, :j], L[j, :j]) if j else A[j, j])
        for i in range(j + 1, n):
            rest = A[i, j] - ca.dot(L[i, :j], L[j, :j]) if j else A[i, j]
            L[i, j] = rest / L[j, j]
    return L


def forward(L: ca.SX, B: ca.SX) -> ca.SX:
    """Return L^-1 B."""
    rows: list[ca.SX] = []
    for i in range(L.shape[0]):
        rest = B[i, :]
        for j in range(i):
            rest = rest - L[i, j] * rows[j]
        rows.append(rest / L[i, i])
    return ca.vertcat(*rows)


def solve(L: ca.SX, B: ca.SX) -> ca.SX:
    """Return (L L^T)^-1 B for a lower triangular L."""
    y = forward(L, B)
    rows: list[ca.SX] = []
    for i in range(L.shape[0] - 1, -1, -1):
        rest = y[i, :]
        for j in range(i + 1, L.shape[0]):
            rest = rest - L[j, i] * rows[L.shape[0] - 1 - j]
        rows.append(rest / L[i, i])
    return ca.vertcat(*rows[::-1])
