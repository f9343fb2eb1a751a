"""What the compiled passes work on: states, samples, channels, scratch of one sample."""

from __future__ import annotations

from typing import NamedTuple

from fsw.messages import FloatArray

CHUNK = 32  # samples whose rows are gathered for one matrix product


class Columns(NamedTuple):
    """First state of each kind, -1 where it is none."""

    base: int
    target: int
    torque_offset: int
    acc_bias: int
    gyro_bias: int
    momentum: int
    torque_scale: int
    wrench: int


class Data(NamedTuple):
    """The arrays of a sample set and its sigmas."""

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    w: FloatArray
    wd: FloatArray
    a: FloatArray
    v: FloatArray
    R: FloatArray
    field: (
        FloatArray  # (N, 3) sqrt(3 mu/R^3) times the unit vector to the zenith in B; (0, 3): none
    )
    s_tau: FloatArray
    s_qdd: FloatArray
    s_w: FloatArray
    s_wd: FloatArray
    s_a: FloatArray
    s_v: FloatArray


class Channels(NamedTuple):
    """What is compared; `measured_rate`: torque at the gyro's rate instead of the predicted."""

    torque: bool
    accelerometer: bool
    gyro: bool
    velocity: bool
    measured_rate: bool


class Prediction(NamedTuple):
    """Scratch of one sample: predictions and rows."""

    tau: FloatArray  # (n,)
    nu: FloatArray  # (6,) base velocity
    a: FloatArray  # (6,) base acceleration
    inverse: FloatArray  # (6, 6) -H_bb^-1
    J_nu: FloatArray  # (6, p)
    L: FloatArray  # (3,) angular momentum in B
    F: FloatArray  # (6,) external wrench in B
    lever: FloatArray  # (3,) integral of -R_NB c
    g: FloatArray  # (6,)
    S: FloatArray  # (m, m) covariance of the residuals, then its factor
    fixed: FloatArray  # (m,) variances of the outputs themselves
    gain: FloatArray  # (m, n+3) sensitivity to unit-variance errors of the inputs
    z: FloatArray  # (m,)
    qdd: FloatArray  # (n,) smoothed
    noisy: tuple[bool, bool]  # joint accelerations, measured rate
    gained: FloatArray  # (2, 3) angular momentum in N from the field so far; its moment before
    J_gained: FloatArray  # (2, 3, p) their derivatives
    row: FloatArray  # (2, 10)
