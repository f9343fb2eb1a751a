"""Residual joint torques of the newest window: measured torque minus predicted torque.

The service process computes them, so that the loop spends no time on them.
"""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import stacked_fused_rows
from fsw.estimators.measurement.impulse import needed
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, Estimate

OF_MEASURED_RATE = ("mrnea", "rda")  # use the gyro's rate, not the rate from the momentum


@dataclass(frozen=True, slots=True)
class TorqueResidual:
    """Root mean square of one joint's residual torque over the instants of a window."""

    rms_nm: float = 0.0
    ratio: float = 0.0  # rms after whitening with the declared noise; 1 if noise alone explains it


class TorqueResiduals:
    """Computes residual torques with the torque rows of the present estimator.

    The base's motion is predicted from the joints' motion and the momentum. The gyro's rate
    replaces the momentum for methods that use the measured rate (MRNEA, RDA), and in runs in which
    external moments change the momentum. Measured accelerations are not used: their noise times the
    arm's inertia would hide the residual.

    Raises
    ------
    ConfigError when the robot cannot be read.
    """

    def __init__(self, config: Config) -> None:
        model = robot_of(config)
        self._problem: Problem = build_problem(config, model, exact=True)
        names = [joint.name for joint in config.joints]
        self._places = [model.joint_names.index(name) for name in names]

    def of(self, block: Block, estimate: Estimate) -> list[TorqueResidual]:
        """Return the residuals in the configuration's joint order; zeros for one without torque.

        The list is empty if the estimate has other states or an inertia not positive definite.
        """
        problem = self._problem
        if estimate.names != problem.names or not block.has_joint.any():
            return []
        by_gyro = estimate.method.lower() in OF_MEASURED_RATE or needed(problem)
        rate: Rate = "measured" if by_gyro and block.has_gyro else "momentum"
        try:
            stack = BlockStack((block,))
            (rows,) = stacked_fused_rows(stack, estimate.mean, problem, ("torque",), rate)
        except np.linalg.LinAlgError:
            return []
        if rows.root is None:
            return []
        joints, m = np.flatnonzero(block.has_joint), len(block.t_ns)
        r = (rows.root @ rows.b).reshape(m, -1)
        S = (rows.root @ rows.root.T).reshape(m, len(joints), m, len(joints))
        found = [TorqueResidual()] * len(block.has_joint)
        for column, joint in enumerate(joints):
            white = np.linalg.solve(np.linalg.cholesky(S[:, column, :, column]), r[:, column])
            rms_nm, ratio = (float(np.sqrt(np.mean(part**2))) for part in (r[:, column], white))
            found[joint] = TorqueResidual(rms_nm, ratio)
        return [found[place] for place in self._places]
