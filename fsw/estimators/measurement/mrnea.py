"""MRNEA: the paper's modified recursive Newton-Euler regression, without its bias.

The whitened rows of a block are A delta = b for a step delta from the state x. There are three
weightings: `ols` (the paper's, eqs. 8-16), `wls` (known output and input noise at the prior) and
`eiv` (errors in variables: base acceleration, rates and joint accelerations are noisy regressors).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs, dtrtrs

from fsw.estimators.effects.carried import Carried
from fsw.estimators.effects.joint_torque import Added, added, fill_columns
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import Impulse, external_force, pulled
from fsw.estimators.measurement.motion_noise import through
from fsw.estimators.measurement.mounting import (
    as_true,
    fill_angle_columns,
    fill_gyro_columns,
    gyro_turn,
    needs_angle_columns,
    turn,
)
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Whitened rows of one block linearised at a state: residual b (k,) and Jacobian A (k, p)."""

    A: FloatArray
    b: FloatArray
    after: Impulse | None = None  # what the block hands on; see `impulse`
    root: FloatArray | None = None  # (k, k) lower root of the noise covariance that whitens
    use: NDArray[np.bool_] | None = None  # (n + 6,) channels at each node: torque, force, rate
    watched: FloatArray | None = None  # (k, q) whitened columns of what might creep; see `creep`
    edge: int = 0  # number of the last rows, which join the motion to the block before

    @property
    def torques(self) -> int:
        """Number of leading rows of each node that are torques; 0 where rows combine channels."""
        return 0 if self.use is None else int(self.use[:-6].sum())

    @property
    def at_nodes(self) -> Self:
        """The rows of the nodes, without those of the edge, by which they are not affected."""
        if not self.edge:
            return self
        k, root = len(self.b) - self.edge, self.root
        root = None if root is None else root[:k, :k]
        watched = None if self.watched is None else self.watched[:k]
        return replace(self, A=self.A[:k], b=self.b[:k], root=root, watched=watched, edge=0)


def base_acceleration(
    block: Block | BlockStack, x: FloatArray, problem: Problem, G: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return w_NB_B (m, 3) minus its bias, and the base's acceleration (m, 6) in B, linear first.

    Both are corrected for the mounting. In free fall the linear acceleration is that of the base's
    origin, minus gravity there: a_b = f_S - bias - wd x r - w x (w x r) + G r.

    Parameters
    ----------
    G : (m, 3, 3) gravity gradient in base axes

    Source: rigid-body kinematics.
    """
    r, wd = problem.place_m(x), block.wd_NB_B_rad_s2
    w, f = block.w_NB_B_rad_s, block.f_NS_B_m_s2
    if problem.has("gyro_bias"):
        w = w - x[problem.at("gyro_bias")]
    if problem.has("acc_bias"):
        f = f - x[problem.at("acc_bias")]
    T = gyro_turn(x, problem)
    w, wd, f = w @ T.T, wd @ T.T, f @ turn(x, problem)[0].T
    a = f - cross(wd, r) - cross(w, cross(w, r)) + G @ r
    return w, np.concatenate([a, wd], axis=1)


def field(block: Block | BlockStack, problem: Problem) -> FloatArray:
    """Return the gravity-gradient field (m, 3, 3) in base axes; zero if no orbit is configured."""
    orbit = problem.orbit
    if orbit is None:
        return np.zeros((len(block.q_rad), 3, 3))
    blocks = block.blocks if isinstance(block, BlockStack) else (block,)
    return np.concatenate([orbit.field(own, problem.window_s) for own in blocks])


def whitened(L: FloatArray, X: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L^-1 X (k, p) and L^-1 r (k,) for a lower root L (k, k)."""
    size, p = X.shape
    if size == 0:  # a block without a usable channel: LAPACK complains on standard output
        return X, r
    stacked = np.empty((size, p + 1), order="F")
    stacked[:, :p], stacked[:, p] = X, r
    white = dtrtrs(L, stacked, lower=1, overwrite_b=1)[0]
    return white[:, :p], white[:, p]


def stacked_mrnea_rows(
    s: BlockStack, x: FloatArray, problem: Problem, weighting: str
) -> list[Rows]:
    """Return the whitened rows of every block, (6+n) m of each.

    With H the joint-space inertia and a the measured accelerations, r = y - Y(a) pi has covariance
    S = G Sigma_z G^T + Sigma_y, where z stacks specific force, gyro and joint-motion errors over
    all nodes of the block (wd is a derivative of the same gyro polynomial) and G = d(Y pi)/dz. The
    Jacobian is evaluated at the smoothed z + Sigma_z G^T S^-1 r, the residual at the measured z.

    Source: paper eqs. (3)-(16); errors-in-variables weighting as in weighted total least squares.
    """
    s, r_S = _prompt(as_true(s, x, problem), x, problem), problem.place_m(x)
    model, n, B = problem.model, s.n, len(s.blocks)
    pi = problem.pi(x)
    model.set_parameters(pi if weighting == "eiv" else problem.pi(problem.prior_mean))
    G = field(s, problem)
    w, a_base = base_acceleration(s, x, problem, G)
    acceleration = np.concatenate([a_base, s.qdd_rad_s2], axis=1)
    tau, gain = _calibrated(s, x, problem)
    more = added(problem.torque_terms, s.joint_motion, x)
    y = np.zeros((len(s.q_rad), 6 + n))
    y[:, 6:] = tau - more.torque_nm
    Y = _regressors(s, w, s.qd_rad_s, acceleration, problem, G)
    r = y - Y @ pi
    H = model.mass_matrices(s.q_rad)
    C, _ = model.forces_and_derivatives(s.q_rad, w, s.qd_rad_s, acceleration)
    C[:, 6:, 6:] += more.by_rate[:, :, None] * np.eye(n)
    H[:, 6:, 6:] += more.by_acceleration[:, :, None] * np.eye(n)
    outside = external_force(s, x, problem) if pulled(problem) else None
    if outside is not None:
        r += outside[0]
    carried = _take_off_carried(r, C, s, x, problem, w)
    G_w = C[:, :, 3:6] + H[:, :, :3] @ (skew(cross(w, r_S)) + skew(w) @ skew(r_S))
    G_wd = H[:, :, 3:6] + H[:, :, :3] @ skew(r_S)
    residuals = r.reshape(B, -1)
    if weighting == "ols":
        sigma = np.sqrt(np.mean(np.einsum("bnii->bni", s.cov_tau), axis=(1, 2)))
        L = sigma[:, None, None] * np.eye(residuals.shape[1])
    else:
        gains = _input_gains(s, H, C, G_w, G_wd)
        L = np.linalg.cholesky(
            gains @ gains.transpose(0, 2, 1) + _output_covariance(s, problem, w, carried)
        )
    if weighting == "eiv":
        weighted = np.array(
            [dpotrs(root, own, lower=1)[0] for root, own in zip(L, residuals, strict=True)]
        )
        unit = (gains.transpose(0, 2, 1) @ weighted[:, :, None])[:, :, 0]
        w, acceleration, qd = _smooth(s, unit, w, acceleration, r_S)
        Y = _regressors(s, w, qd, acceleration, problem, G)
    X = np.zeros((len(s.q_rad), 6 + n, len(x)))
    X[:, :, problem.inertial] = Y @ problem.U
    _nuisance_columns(X, tau, gain, (H, G_w), x, problem)
    fill_columns(X[:, 6:], problem.torque_terms, s.accelerated(acceleration[:, 6:]))
    _mounting_columns(X, x, (w, acceleration, G), (H, G_w, G_wd), problem)
    if needs_angle_columns(problem):
        D_q = _by_angle(s, w, acceleration, problem, more)
        fill_angle_columns(X, (D_q, C[:, :, 6:], H[:, :, 6:]), s, x, problem)
    if outside is not None:
        X -= outside[1]
    if carried is not None:
        X[:, 3:6] += carried.by_state(w)
    _delay_columns(X, tau - r[:, 6:], (w, acceleration[:, 3:6]), (H, G_w, G_wd), s, x, problem)
    X = X.reshape(B, residuals.shape[1], len(x))
    return [
        Rows(*whitened(root, columns, own))
        for root, columns, own in zip(L, X, residuals, strict=True)
    ]


def _prompt(s: BlockStack, x: FloatArray, problem: Problem) -> BlockStack:
    """Return the blocks with all readings as they would be without their delays."""
    if not problem.delays:
        return s
    back = problem.delays.back(x, s.m)
    late = np.concatenate([s.tau_nm, s.f_NS_B_m_s2, s.w_NB_B_rad_s], axis=1)
    prompt = problem.delays.prompt(x, late, s.m)
    other = s.noise_through(back).turning(prompt[:, -3:])
    other.tau_nm, other.f_NS_B_m_s2 = prompt[:, : s.t], prompt[:, s.t : -3]
    other.wd_NB_B_rad_s2 = problem.delays.prompt(x, s.wd_NB_B_rad_s2, s.m)
    return other


def _delay_columns(
    X: FloatArray,
    tau_nm: FloatArray,
    rates: tuple[FloatArray, FloatArray],
    gains: tuple[FloatArray, FloatArray, FloatArray],
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
) -> None:
    """Add the columns of delays; torques (N, n) as predicted; `gains` as of `_mounting_columns`."""
    if not problem.delays:
        return
    (H, G_w, G_wd), W, states = gains, problem.delays.of_channels, problem.delays.states
    tau, w, wd, f = (problem.delays.slope(own, s.m) for own in (tau_nm, *rates, s.f_NS_B_m_s2))
    X[:, 6:, states] -= tau[:, :, None] * W[: s.n]
    by_rate = G_w @ w[:, :, None] + G_wd @ wd[:, :, None]
    by_force = H[:, :, :3] @ (f @ turn(x, problem)[0].T)[:, :, None]
    X[:, :, states] += by_rate * W[-1] + by_force * W[-4]


def _by_angle(
    s: BlockStack, w: FloatArray, acceleration: FloatArray, problem: Problem, more: Added
) -> FloatArray:
    """Return d(generalised force)/dq (N, 6 + n, n), with the torques `more`."""
    D_q = problem.model.angle_derivatives(s.q_rad, w, s.qd_rad_s, acceleration)
    D_q[:, 6:] += more.by_angle[:, :, None] * np.eye(s.n)
    return D_q


def _take_off_carried(
    r: FloatArray, C: FloatArray, s: BlockStack, x: FloatArray, problem: Problem, w: FloatArray
) -> Carried | None:
    """Subtract the moment of carried momentum from r, add its derivative to C; return it."""
    carried = problem.carrier(s, x)
    if carried is not None:
        r[:, 3:6] -= carried.moment(w)
        C[:, 3:6, 3:6] += carried.by_rate()
    return carried


def _calibrated(s: BlockStack, x: FloatArray, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return the torques (N, n) corrected for offset and scale, and the scale (n,)."""
    tau, gain = s.tau_nm, np.ones(s.n)
    if problem.has("torque_offset"):
        tau = tau - x[problem.at("torque_offset")]
    if problem.has("torque_scale"):
        gain = 1.0 + x[problem.at("torque_scale")]
    return tau / gain, gain


def _regressors(
    s: BlockStack,
    w: FloatArray,
    qd: FloatArray,
    acceleration: FloatArray,
    problem: Problem,
    G: FloatArray,
) -> FloatArray:
    """Return Y (N, 6+n, 10 (n+1)) at the nodes minus that of the field."""
    Y = problem.model.regressors(s.q_rad, w, qd, acceleration)
    if problem.orbit is not None:
        Y -= problem.model.field_regressors(s.q_rad, G)
    return Y


def _mounting_columns(
    X: FloatArray,
    x: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    gains: tuple[FloatArray, FloatArray, FloatArray],
    problem: Problem,
) -> None:
    """Fill the columns of the inertial unit's place and attitude, and of its gyro.

    Parameters
    ----------
    motion : the base's rate (m, 3) and acceleration (m, 6+n), the field (m, 3, 3)
    gains : derivatives of the rows by the base's acceleration (first three columns), by w, by wd
    """
    (w, acceleration, G), (H, G_w, G_wd) = motion, gains
    wd, r = acceleration[:, 3:6], problem.place_m(x)
    arm = skew(wd) + skew(w) @ skew(w) - G
    if problem.has("imu_place"):
        X[:, :, problem.at("imu_place")] = -H[:, :, :3] @ arm
    if problem.has("imu_angle"):
        f = acceleration[:, :3] + (arm @ r[:, None])[:, :, 0]
        turned = G_w @ skew(w) + G_wd @ skew(wd) + H[:, :, :3] @ skew(f)
        X[:, :, problem.at("imu_angle")] = -turned @ turn(x, problem)[1]
    fill_gyro_columns(X, G_w, w, x, problem)
    fill_gyro_columns(X, G_wd, wd, x, problem)


def _nuisance_columns(
    X: FloatArray,
    tau_nm: FloatArray,
    gain: FloatArray,
    gains: tuple[FloatArray, FloatArray],
    x: FloatArray,
    problem: Problem,
) -> None:
    """Fill the columns of torques and biases of X (m, 6+n, p); `gains`: see `_mounting_columns`."""
    n, (H, G_w) = len(gain), gains
    if problem.has("torque_offset"):
        X[:, 6:, problem.at("torque_offset")] = np.diag(1.0 / gain)
    if problem.has("torque_scale"):
        X[:, 6:, problem.at("torque_scale")] = (tau_nm / gain)[:, :, None] * np.eye(n)
    if problem.has("acc_bias"):
        X[:, :, problem.at("acc_bias")] = -H[:, :, :3] @ turn(x, problem)[0]
    if problem.has("gyro_bias"):
        X[:, :, problem.at("gyro_bias")] = -G_w @ gyro_turn(x, problem)


def _input_gains(
    s: BlockStack, H: FloatArray, C: FloatArray, G_w: FloatArray, G_wd: FloatArray
) -> FloatArray:
    """Return d(Y pi)/d(unit-variance input errors), (B, m (6+n), inputs) as [f | gyro | joints].

    Each input's covariance over a block's nodes is factorised, so that S = G G^T.
    """
    m, B = s.m, len(s.blocks)
    acc, gyro = s.root_acc, s.root_gyro
    # columns ordered (axis, factor)
    G_f = np.einsum("birk,bif->birkf", s.by_block(H[:, :, :3]), acc)
    G_g = np.einsum("birk,bif->birkf", s.by_block(G_w), gyro[:, :m])
    G_g += np.einsum("birk,bif->birkf", s.by_block(G_wd), gyro[:, m:])
    root = s.root_rates
    G_q = np.einsum("birj,bjif->birjf", s.by_block(C[:, :, 6:]), root[:, :, :m])
    G_q += np.einsum("birj,bjif->birjf", s.by_block(H[:, :, 6:]), root[:, :, m:])
    rows = m * H.shape[1]
    parts = [part.reshape(B, rows, part.shape[3] * part.shape[4]) for part in (G_f, G_g, G_q)]
    return np.concatenate(parts, axis=2)


def _output_covariance(
    s: BlockStack, problem: Problem, w: FloatArray, carried: Carried | None
) -> FloatArray:
    m, n, B = s.m, s.n, len(s.blocks)
    S = np.zeros((B, m, 6 + n, m, 6 + n))
    i = np.arange(m)
    for row in range(6):
        S[:, i, row, i, row] = problem.wrench_sigma[row] ** 2
    for j in range(n):
        S[:, :, 6 + j, :, 6 + j] = s.cov_tau[:, j]
    if carried is not None:
        own = s.cov_carried.reshape(B, -1, 2, m, 2, m)
        S[:, :, 3:6, :, 3:6] += through(s, carried.by_motion(w), own)
    return S.reshape(B, m * (6 + n), m * (6 + n))


def _smooth(
    s: BlockStack, unit: FloatArray, w: FloatArray, acceleration: FloatArray, r: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Apply unit-variance input corrections (B, inputs); return corrected w, acceleration, qd."""
    m, n, B = s.m, s.n, len(s.blocks)
    split = 3 * s.root_acc.shape[2]
    stop = split + 3 * s.root_gyro.shape[2]
    f = np.einsum("bmf,bkf->bmk", s.root_acc, unit[:, :split].reshape(B, 3, -1)).reshape(-1, 3)
    g = np.einsum("bmf,bkf->bmk", s.root_gyro, unit[:, split:stop].reshape(B, 3, -1))
    dw, dwd = g[:, :m].reshape(-1, 3), g[:, m:].reshape(-1, 3)
    smoothed = acceleration.copy()
    w_new = w + dw
    smoothed[:, :3] += f - cross(dwd, r) - cross(w_new, cross(w_new, r))
    smoothed[:, :3] += cross(w, cross(w, r))
    smoothed[:, 3:6] += dwd
    roots = s.root_rates
    step = np.einsum("bjaf,bjf->baj", roots, unit[:, stop:].reshape(B, n, roots.shape[3]))
    qd = s.qd_rad_s + step[:, :m].reshape(B * m, n)
    smoothed[:, 6:] += step[:, m:].reshape(B * m, n)
    return w_new, smoothed, qd
