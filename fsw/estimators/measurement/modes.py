"""Modes of the base: their motion over a window, and its effect on every channel.

A released mode is a joint whose torque is that of its spring and damper. Its motion follows from
that of the arm, from its own start, and from the state. Over a window the motion is a polynomial
that satisfies the mode's equation at the nodes (Gauss collocation, of order 2 m):

    tau_e(eta, v, z) + K eta + C v = 0,    v = v0 + A z,    eta = eta0 + t v0 + A^2 z

with z the accelerations at the nodes, t the time since the window's start and A the integrals of
the interpolant. One Newton step from z = 0 and a linear correction solve it to third order in the
curvature, and the same factorisation gives the exact derivatives. The next window starts with eta
and v at the end of this one, and with their derivatives by the state.

Noise of the arm's motion acts at its own node, through z with eta and v held. After a gap the mode
may be anywhere within its amplitude. The windows after the gap share this error until it has died
away, so each of them counts its variance as many times as there are windows in that time. Source:
Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), sec. II.7.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import Impulse, integration, span_ns
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.modes import Modes
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


@dataclass(slots=True, eq=False)
class Channels:
    """Torque, specific force and rate of ideal sensors, and their derivatives.

    N nodes of B blocks, n joints, p states, k components of carried momentum, c modes; t torques:
    those of the joints, then the axes of wrench sensors.
    """

    tau: FloatArray  # (N, t)
    f: FloatArray  # (N, 3)
    w: FloatArray  # (N, 3)
    D: FloatArray  # (N, t + 6, 2 n + 3 + p): d[tau; f; w]/d[qdd, w, qd, x]
    D_q: FloatArray | None  # (N, t + 6, n): d[tau; f; w]/dq
    D_carried: FloatArray | None  # (2, N, t + 6, k): by carried momentum, then by its derivative
    each: tuple[Impulse | None, ...]  # momentum, and modes, at the end of each block
    D_start: FloatArray | None = None  # (N, t + 6, 2 c): by the modes at the block's start
    doubt: FloatArray | None = None  # (B, 2 c) variance of these modes not due to the state


Ideal = Callable[[BlockStack, FloatArray, Problem, Rate, Impulse | None], Channels]


def released(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    rate: Rate,
    before: Impulse | None,
    ideal: Ideal,
) -> Channels:
    """Return the channels of the released robot; `ideal` predicts them for given joint motion."""
    parts = []
    for k, block in enumerate(s.blocks):
        at = slice(k * s.m, (k + 1) * s.m)
        joints = s.q_rad[at], s.qd_rad_s[at], s.qdd_rad_s2[at]
        parts.append(_window(block, joints, x, problem, rate, before, ideal))
        before = parts[-1].each[0]
    if len(parts) == 1:
        return parts[0]
    D_carried = [part.D_carried for part in parts if part.D_carried is not None]
    return Channels(
        tau=np.concatenate([part.tau for part in parts]),
        f=np.concatenate([part.f for part in parts]),
        w=np.concatenate([part.w for part in parts]),
        D=np.concatenate([part.D for part in parts]),
        D_q=np.concatenate([part.D_q for part in parts if part.D_q is not None]),
        D_carried=np.concatenate(D_carried, axis=1) if D_carried else None,
        each=tuple(part.each[0] for part in parts),
        D_start=np.concatenate([part.D_start for part in parts if part.D_start is not None]),
        doubt=np.concatenate([part.doubt for part in parts if part.doubt is not None]),
    )


@dataclass(slots=True, eq=False)
class _Window:
    """Quantities common to the steps at one window: m nodes, n joints, c coordinates."""

    block: Block
    joints: tuple[FloatArray, FloatArray, FloatArray]  # q, qd, qdd (m, n)
    start: FloatArray  # (2 c,)
    springs: FloatArray  # (2, c)
    A: FloatArray  # (m, m)
    t_s: FloatArray  # (m, 1)

    def motion(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return coordinates and rates (m, c) by the accelerations z (m, c)."""
        eta0, v0 = np.split(self.start, 2)
        return eta0 + self.t_s * v0 + self.A @ self.A @ z, v0 + self.A @ z


@dataclass(slots=True, eq=False)
class _Step:
    """The released robot at one guess of z, and the linear system for the next guess."""

    eta: FloatArray  # (m, c)
    v: FloatArray
    channels: Channels  # of n + c joints
    by_q: FloatArray  # (m, t + c + 6, n + c)
    inertia: FloatArray  # (m, c, c): d(tau_e + K eta + C v)/d[z, eta, v] at a node
    stiff: FloatArray
    damp: FloatArray
    system: FloatArray  # (m c, m c), of all nodes together
    wrong: FloatArray  # (m, c) residual of the equation


def _step(
    a: _Window,
    z: FloatArray,
    x: FloatArray,
    moving: Problem,
    rate: Rate,
    before: Impulse | None,
    ideal: Ideal,
) -> _Step:
    (m, n), c = a.joints[0].shape, z.shape[1]
    eta, v = a.motion(z)
    q, qd, qdd = (np.hstack(pair) for pair in zip(a.joints, (eta, v, z), strict=True))
    extended = replace(a.block, q_rad=q, qd_rad_s=qd, qdd_rad_s2=qdd)
    at = ideal(BlockStack((extended,)), x, moving, rate, before)
    if at.D_q is None:
        raise ValueError("the modes need the derivatives by angle")
    own, last = slice(n, n + c), 2 * (n + c) + 3
    inertia = at.D[:, own, own]
    stiff = at.D_q[:, own, own] + np.diag(a.springs[0])
    damp = at.D[:, own, last - c : last] + np.diag(a.springs[1])
    system = np.einsum("iab,ij->iajb", stiff, a.A @ a.A) + np.einsum("iab,ij->iajb", damp, a.A)
    system[np.arange(m), :, np.arange(m)] += inertia
    wrong = at.tau[:, own] + a.springs[0] * eta + a.springs[1] * v
    return _Step(eta, v, at, at.D_q, inertia, stiff, damp, system.reshape(m * c, m * c), wrong)


def _window(
    block: Block,
    joints: tuple[FloatArray, FloatArray, FloatArray],
    x: FloatArray,
    problem: Problem,
    rate: Rate,
    before: Impulse | None,
    ideal: Ideal,
) -> Channels:
    modes = _modes(problem)
    (m, n), c = joints[0].shape, len(modes.of)
    cumulative, weights = integration(m)
    half_s = 0.5 * problem.window_s
    A = half_s * cumulative
    springs, spring_x = modes.springs(x)
    start, J_start, doubt = _start(block, x, problem, before)
    a = _Window(block, joints, start, springs, A, A.sum(axis=1)[:, None])
    s = _step(a, np.zeros((m, c)), x, modes.released, rate, before, ideal)
    z: FloatArray = -np.asarray(np.linalg.solve(s.system, s.wrong.ravel())).reshape(m, c)
    s = _step(a, z, x, modes.released, rate, before, ideal)
    Z = _sensitivities(a, s, spring_x, problem)
    at, own = s.channels, slice(n, n + c)
    keep, t = np.r_[0:n, n + c : at.D.shape[1]], at.tau.shape[1] - c
    last, eye = 2 * (n + c) + 3, np.eye(2 * c)
    E, V = (np.einsum("ij,jcp->icp", B, Z) for B in (A @ A, A))
    E[:, :, 1 : 1 + 2 * c] += eye[:c] + a.t_s[:, :, None] * eye[c:]
    V[:, :, 1 : 1 + 2 * c] += eye[c:]
    by_z, by_v = at.D[:, keep, own], at.D[:, keep, last - c : last]
    total = by_z @ Z + s.by_q[:, keep, own] @ E + by_v @ V
    D_start = total[:, :, 1 : 1 + 2 * c]
    J = at.D[:, keep, last:] + total[:, :, 1 + 2 * c :] + D_start @ J_start
    D = at.D[:, keep] - by_z @ np.linalg.solve(s.inertia, at.D[:, own])  # eta and v held
    D_q = s.by_q[:, keep, :n] - by_z @ np.linalg.solve(s.inertia, s.by_q[:, own, :n])
    D_carried = at.D_carried
    if D_carried is not None:
        D_carried = D_carried[:, :, keep] - by_z @ np.linalg.solve(s.inertia, D_carried[:, :, own])
    if problem.has("joint_zero"):  # `predict` adds D_q, as without modes
        J[:, :, problem.at("joint_zero")] += s.by_q[:, keep, :n] - D_q
    given = np.concatenate([at.tau, at.f, at.w], axis=1)[:, keep] + total[:, :, 0]
    J_end = np.concatenate(
        [np.einsum("j,jcp->cp", half_s * row, Z) for row in (weights @ A, weights)]
    )
    J_end[:, 1 : 1 + 2 * c] += eye + problem.window_s * np.eye(2 * c, k=c)
    end = np.concatenate([weights @ A @ z, weights @ z]) * half_s + J_end[:, 0]
    end += start
    end[:c] += problem.window_s * start[c:]
    p = len(x)
    after = at.each[0] or Impulse(
        span_ns(block, problem.window_s)[1], np.zeros(3), np.zeros((3, p)), x
    )
    fading = np.exp(-2.0 * modes.damping_ratio * modes.rate_rad_s * problem.window_s)
    J_modes = J_end[:, 1 + 2 * c :] + J_end[:, 1 : 1 + 2 * c] @ J_start
    carried = replace(after, modes=end, J_modes=J_modes, doubt=doubt * np.tile(fading, 2))
    return Channels(
        tau=given[:, :t],
        f=given[:, t : t + 3],
        w=given[:, t + 3 :],
        D=np.concatenate([D[:, :, :n], D[:, :, n + c : last - c], J], axis=2),
        D_q=D_q,
        D_carried=D_carried,
        each=(carried,),
        D_start=D_start,
        doubt=doubt[None],
    )


def _sensitivities(a: _Window, s: _Step, spring_x: FloatArray, problem: Problem) -> FloatArray:
    """Return z's last correction and its derivatives by start and state (m, c, 1 + 2 c + p)."""
    m, c = s.wrong.shape
    n, last = a.joints[0].shape[1], s.channels.D.shape[2] - spring_x.shape[2]
    by_x = s.channels.D[:, n : n + c, last:] + s.eta[:, :, None] * spring_x[0]
    by_x += s.v[:, :, None] * spring_x[1]
    if problem.has("joint_zero"):
        by_x[:, :, problem.at("joint_zero")] += s.by_q[:, n : n + c, :n]
    drift = s.stiff * a.t_s[:, :, None] + s.damp
    by = np.concatenate([s.wrong[:, :, None], s.stiff, drift, by_x], axis=2)
    solved = np.linalg.solve(s.system, by.reshape(m * c, -1))
    return np.asarray(-solved.reshape(by.shape))


def _modes(problem: Problem) -> Modes:
    if problem.modes is None:
        raise ValueError("the problem has no modes")
    return problem.modes


def _start(
    block: Block, x: FloatArray, problem: Problem, before: Impulse | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return modes at the window's start (2 c,), d/dx (2 c, p), variances not due to the state."""
    modes, states = _modes(problem), problem.at("mode_start")
    size = states.stop - states.start
    if before is None or not len(before.modes):
        return x[states], np.eye(len(x))[states], np.zeros(size)
    start_ns, stop_ns = span_ns(block, problem.window_s)
    if start_ns - before.end_ns <= (stop_ns - start_ns) // 2:
        return before.modes_at(x), before.J_modes, before.doubt
    lasting = 1.0 / (2.0 * modes.damping_ratio * modes.rate_rad_s * problem.window_s)
    spread = modes.amplitude**2 * np.maximum(lasting, 1.0)
    doubt = np.concatenate([spread, modes.rate_rad_s**2 * spread])
    return np.zeros(size), np.zeros((size, len(x))), doubt
