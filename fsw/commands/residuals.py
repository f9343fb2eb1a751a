"""Residuals of every channel at a state, in its unit and over its own sigma."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.measurement.block_stack import BlockStack, stacks_of
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray

SENSORS = (("specific_force", "m/s2"), ("rate", "rad/s"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelResiduals:
    """Measured less predicted at N nodes; c channels: torques, specific force xyz, rate xyz."""

    names: tuple[str, ...]  # (c,)
    units: tuple[str, ...]  # (c,)
    t_ns: NDArray[np.int64]  # (N,)
    value: FloatArray  # (N, c), NaN: channel not usable there
    sigma: FloatArray  # (N, c) of the residual: noise of sensor and motion, and of the state

    @property
    def normalised(self) -> FloatArray:
        """Return the residuals over their sigmas (N, c)."""
        ratio: FloatArray = self.value / self.sigma
        return ratio


def channel_residuals(
    blocks: Sequence[Block],
    x: FloatArray,
    problem: Problem,
    covariance: FloatArray | None = None,
) -> ChannelResiduals:
    """Return the residuals of blocks at a state.

    Parameters
    ----------
    covariance : (p, p) of the state, for blocks that it was not estimated from; None: x is exact

    Raises
    ------
    numpy.linalg.LinAlgError if the base has no inertia at this state.
    """
    joints = problem.model.joint_names
    parts: list[tuple[FloatArray, FloatArray]] = []
    before: Impulse | None = None
    for stack in stacks_of(blocks):
        value, sigma, before = _stacked(stack, x, problem, covariance, before)
        parts.append((value, sigma))
    sensors = [(f"{name}.{axis}", unit) for (name, unit), axis in product(SENSORS, "xyz")]
    return ChannelResiduals(
        names=(*(f"torque.{name}" for name in joints), *(name for name, _ in sensors)),
        units=(*("N m" for _ in joints), *(unit for _, unit in sensors)),
        t_ns=np.concatenate([block.t_ns for block in blocks]),
        value=np.concatenate([value for value, _ in parts]),
        sigma=np.concatenate([sigma for _, sigma in parts]),
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
