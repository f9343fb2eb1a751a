"""The angular momentum that a measured rate shows, as the first point of linearisation.

Torque and specific force are quadratic in the base's rate. Linearised at rest they do not depend on
it, and effects of a tumbling captured object would count as errors of bodies and sensors.
"""

import numpy as np

from fsw.errors import NUMERICAL
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


def at_first_rate(block: Block, x: FloatArray, problem: Problem) -> FloatArray:
    """Return the state with the momentum at which the block's measured rate is predicted.

    The predicted rate is affine in the momentum, so one step is exact. The state is unchanged if
    momentum is not estimated, rate or attitude are missing, or the bodies have no inertia.
    """
    if not (problem.has("momentum") and block.has_gyro and block.has_attitude):
        return x
    try:
        at = predict(block, x, problem)
        J = at.J_w[:, :, problem.at("momentum")].reshape(-1, 3)
        step = np.linalg.lstsq(J, (block.w_NB_B_rad_s - at.w_rad_s).ravel(), rcond=None)[0]
    except NUMERICAL:
        return x
    found = x.copy()
    found[problem.at("momentum")] += step
    return found if np.isfinite(found).all() else x
