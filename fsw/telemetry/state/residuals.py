"""Residual joint torques of the newest window: measured less what the estimate predicts.

Made here, in the service process, so that the loop has no work with it.
"""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.estimators.measurement.fused import fused_rows
from fsw.estimators.measurement.impulse import needed
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, Estimate

OF_MEASURED_RATE = ("mrnea", "rda")  # methods that use the gyro's rate, not the momentum's


@dataclass(frozen=True, slots=True)
class TorqueResidual:
    """Residual torque of one joint over a window's instants."""

    rms_nm: float = 0.0
    ratio: float = 0.0  # rms after whitening with the declared noise: 1 is what noise explains


class TorqueResiduals:
    """Residual torques by the torque channel of the estimator in force.

    The base's motion is predicted from the joints' motion and the momentum; methods that use the
    measured rate (MRNEA, RDA), and runs in which external moments change the momentum, take the
    gyro's rate. A measured acceleration enters nowhere: its noise times the arm's inertia would
    hide the residual.

    Raises
    ------
    ConfigError when the robot cannot be read.
    """

    def __init__(self, config: Config) -> None:
        model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
        self._problem: Problem = build_problem(config, model, exact=True)
        names = [joint.name for joint in config.joints]
        self._places = [model.joint_names.index(name) for name in names]

    def of(self, block: Block, estimate: Estimate) -> list[TorqueResidual]:
        """Return the residuals in the configuration's order; a joint without torque has zeros.

        None at all of an estimate of other states, or whose inertia is not positive definite.
        """
        problem = self._problem
        if estimate.names != problem.names or not block.has_joint.any():
            return []
        by_gyro = estimate.method.lower() in OF_MEASURED_RATE or needed(problem)
        rate: Rate = "measured" if by_gyro and block.has_gyro else "momentum"
        try:
            rows = fused_rows(block, estimate.mean, problem, ("torque",), rate)
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
