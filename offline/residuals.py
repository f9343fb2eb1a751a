"""Residuals of all channels for a given state, in the channel's unit and divided by sigma."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.estimators.batch.run import with_noise_found
from fsw.estimators.measurement.block_stack import BlockStack, stacks_of
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.measurement.row_functions import MOST_BLOCKS
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray

FALSE_ALARM = 1e-4  # probability per channel that a correct model is called wrong
INDEPENDENT = 0.5  # share of nodes counted as independent: motion noise correlates a window's nodes
WIDE = 1.2  # ratio of residuals to sigma that a user sees in a histogram and should know of
SENSORS = (("specific_force", "m/s2"), ("rate", "rad/s"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelResiduals:
    """Measured minus predicted at N nodes in c channels: torques, specific force (B), rate (B)."""

    names: tuple[str, ...]  # (c,)
    units: tuple[str, ...]  # (c,)
    t_ns: NDArray[np.int64]  # (N,)
    value: FloatArray  # (N, c), NaN: channel not usable there
    sigma: FloatArray  # (N, c) 1 sigma of `value`, as an estimate counts it

    @property
    def normalised(self) -> FloatArray:
        """Return the residuals divided by their sigmas (N, c)."""
        ratio: FloatArray = self.value / self.sigma
        return ratio

    def wide(self) -> dict[str, float]:
        """Return rms / sigma of the channels whose residuals scatter more than their sigma.

        A channel of a correct model is among them with a probability of at most FALSE_ALARM.
        """
        squares, counts = self.normalised**2, np.isfinite(self.value).sum(axis=0)
        found = {}
        for name, square, count in zip(self.names, squares.T, counts, strict=True):
            freedoms = max(1.0, INDEPENDENT * float(count))
            bound = max(WIDE, float(np.sqrt(chdtri(freedoms, FALSE_ALARM) / freedoms)))
            rms = float(np.sqrt(np.nansum(square) / max(count, 1)))
            if rms > bound:
                found[name] = rms
        return found


def channel_residuals(
    blocks: Sequence[Block],
    x: FloatArray,
    problem: Problem,
    covariance: FloatArray | None = None,
) -> ChannelResiduals:
    """Return the residuals of blocks for the state x (p,).

    Their sigma is what an estimate from these blocks counts: the noise of sensors, declared or
    found, the declared torques outside of the model, and the noise of motion and state.

    Parameters
    ----------
    covariance : (p, p) of x, for blocks from which x was not estimated; None: x counts as exact

    Raises
    ------
    numpy.linalg.LinAlgError if the base has no inertia in this state.
    """
    torques = problem.model.torque_units
    sensors = [(f"{name}.{axis}", unit) for (name, unit), axis in product(SENSORS, "xyz")]
    t_ns = np.concatenate([block.t_ns for block in blocks])
    values, sigmas = np.empty((2, len(t_ns), len(torques) + len(sensors)))
    stop = 0
    before: Impulse | None = None
    noisy, _ = with_noise_found(problem, blocks)
    for first in range(0, len(noisy), MOST_BLOCKS):
        for stack in stacks_of(noisy[first : first + MOST_BLOCKS]):
            value, sigma, before = _stacked(stack, x, problem, covariance, before)
            own = slice(stop, stop := stop + len(value))
            values[own], sigmas[own] = value, sigma
    return ChannelResiduals(
        names=(*(f"torque.{name}" for name in torques), *(name for name, _ in sensors)),
        units=(*torques.values(), *(unit for _, unit in sensors)),
        t_ns=t_ns,
        value=values,
        sigma=sigmas,
    )


def _stacked(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    covariance: FloatArray | None,
    before: Impulse | None,
) -> tuple[FloatArray, FloatArray, Impulse | None]:
    at = predict(s, x, problem, "momentum", before)
    measured = np.concatenate([s.tau_nm, s.f_NS_B_m_s2, s.w_NB_B_rad_s], axis=1)
    predicted = np.concatenate([at.tau_nm, at.f_m_s2, at.w_rad_s], axis=1)
    c = measured.shape[1]
    S = residual_covariance(s, at, np.ones(c, np.bool_), "momentum")
    variance = np.diagonal(S, axis1=1, axis2=2).reshape(-1, c)
    if covariance is not None:
        variance = variance + np.einsum("nci,ij,ncj->nc", at.J, covariance, at.J)
    usable = np.concatenate([s.has_joint, np.full(3, s.has_accelerometer), np.full(3, s.has_gyro)])
    value = np.where(usable, measured - predicted, np.nan)
    return value, np.sqrt(variance), at.after
