"""The error that an effect causes if it is in the truth but left out of the model.

Linearised and whitened, rows A delta = b with prior information L have the solution
P A^T b, P = (A^T A + L)^-1. A disturbance d that the model leaves out shifts the solution by
P A^T d. If the effect has states with columns C and prior covariance S, d is C s with s of
covariance S, and the estimate's error has covariance (P A^T C) S (P A^T C)^T. For any other effect,
d is the difference of the predictions along the same motion with and without the effect.

Source: Tapley, Schutz, Born, Statistical Orbit Determination (2004), ch. 6 (consider covariance).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from fsw.config import Config
from fsw.estimators.conditioning.polynomial import differentiation, gauss_nodes
from fsw.estimators.measurement.block_stack import stacks_of
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse, integration
from fsw.estimators.measurement.row_functions import row_function, stack
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray, IntArray
from planner import criteria
from planner.sampled import sampled_blocks
from planner.spline import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """The error of every state that a left-out effect causes, and the state's predicted sigma."""

    error: FloatArray  # (p,) 1 sigma of the error, or the bias itself
    sigma: FloatArray  # (p,)


class Information:
    """The estimator's rows over given blocks, linearised at the prior mean, and the prior."""

    def __init__(self, problem: Problem, method: str, blocks: Sequence[Block]) -> None:
        self.problem = problem
        self._rows = row_function(method, "eiv", problem)
        found = stack(self._rows, blocks, problem.prior_mean)
        self._A = np.concatenate([own.A for own in found])
        self._b = np.concatenate([own.b for own in found])
        self._whole: tuple[FloatArray, FloatArray] | None = None

    def without(self, states: IntArray, apart: IntArray) -> Shift:
        """Return the errors if the model leaves `states` out; truth and model both lack `apart`."""
        p = len(self.problem.names)
        kept = np.setdiff1d(np.arange(p), np.concatenate([states, apart]))
        R, back = self._solved(kept)
        to_errors = back @ self._A[:, states]
        prior = self.problem.prior_covariance[np.ix_(states, states)]
        error, sigma = np.zeros((2, p))
        error[kept] = np.sqrt(np.sum((to_errors @ prior) * to_errors, axis=1))
        sigma[kept] = _sigma(R)
        return Shift(error, sigma)

    def shift(self, blocks: Sequence[Block]) -> Shift:
        """Return by how much the estimate differs for other measurements in the same blocks."""
        if self._whole is None:
            self._whole = self._solved(np.arange(len(self.problem.names)))
        R, back = self._whole
        found = stack(self._rows, blocks, self.problem.prior_mean)
        b = np.concatenate([own.b for own in found])
        return Shift(back @ (b - self._b), _sigma(R))

    def _solved(self, kept: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the information root of the states `kept`, and P A^T for these states."""
        A = self._A[:, kept]
        prior = criteria.prior_root(self.problem.prior_covariance[np.ix_(kept, kept)])
        R = criteria.triangular_root(np.concatenate([prior, A]))
        return R, solve_triangular(R, solve_triangular(R, A.T, trans=1))


def _sigma(R: FloatArray) -> FloatArray:
    inverse = solve_triangular(R, np.eye(len(R)))
    return np.asarray(np.sqrt(np.sum(inverse**2, axis=1)))


def blocks_along(config: Config, problem: Problem, trajectory: Trajectory) -> list[Block]:
    """Return the blocks of a motion with the measurements predicted at the problem's prior mean."""
    count = len(problem.model.torque_units)

    def still(t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return np.zeros((len(t_s), count)), np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))

    blocks = sampled_blocks(config, problem.model, trajectory, still)
    return measured(blocks, channels(blocks, problem))


def channels(blocks: Sequence[Block], problem: Problem) -> list[FloatArray]:
    """Return predicted torque, specific force and rate (m, t + 6) per block, at the prior mean."""
    before: Impulse | None = None
    found: list[FloatArray] = []
    for s in stacks_of(blocks):
        at = predict(s, problem.prior_mean, problem, "momentum", before)
        before = at.after
        whole = np.concatenate([at.tau_nm, at.f_m_s2, at.w_rad_s], axis=1)
        found += np.split(whole, len(s.blocks))
    return found


def measured(blocks: Sequence[Block], values: Sequence[FloatArray]) -> list[Block]:
    """Return the blocks with their measured channels replaced by `values`, (m, t + 6) per block."""
    return [
        replace(
            block,
            tau_nm=own[:, :-6],
            f_NS_B_m_s2=own[:, -6:-3],
            w_NB_B_rad_s=own[:, -3:],
            wd_NB_B_rad_s2=derivative(own[:, -3:], 1e-9 * half_ns(block)),
        )
        for block, own in zip(blocks, values, strict=True)
    ]


def half_ns(block: Block) -> float:
    """Return half the length of a block's window [ns], from its first and last node."""
    length_ns, share = (
        float(block.t_ns[-1] - block.t_ns[0]),
        float(gauss_nodes(len(block.t_ns))[-1]),
    )
    return 0.5 * length_ns / share


def derivative(values: FloatArray, half_s: float) -> FloatArray:
    """Return the time derivative (m, k) at the nodes of the polynomial through `values` (m, k)."""
    return differentiation(len(values)) @ values / half_s


def late(values: FloatArray, delays_s: FloatArray, half_s: float) -> FloatArray:
    """Return channels (m, k) delayed by `delays_s` (k,) [s], to first order."""
    return values - delays_s * derivative(values, half_s)


def held(blocks: Sequence[Block], problem: Problem) -> list[Block]:
    """Return blocks in which what can turn in the base holds it still within its limits."""
    model, x, most_nm = problem.model, problem.prior_mean, problem.carrier.most_nm
    to_axes = np.linalg.pinv(problem.carrier.axes)
    momentum, found = np.zeros(len(most_nm)), []
    for block, free in zip(blocks, channels(blocks, problem), strict=True):
        model.set_parameters(problem.pi(x))
        H = model.mass_matrices(block.q_rad)[:, :6, :6]
        about_com = H[:, 3:, 3:] - H[:, 3:, :3] @ H[:, :3, 3:] / H[:, :1, :1]
        half_s = 1e-9 * half_ns(block)
        wanted = (about_com @ free[:, -3:, None])[:, :, 0] @ to_axes.T
        torque = np.clip(derivative(wanted, half_s), -most_nm, most_nm)
        cumulative, weights = integration(len(torque))
        held_nms = momentum + half_s * cumulative @ torque
        found.append(replace(block, carried_nms=held_nms, carried_nm=torque))
        momentum = momentum + half_s * weights @ torque
    return found
