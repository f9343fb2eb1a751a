"""Residual joint torques of the newest window: measured less what the estimate explains.

Made here, in the service process, so that the loop has no work with it.
"""

from __future__ import annotations

import numpy as np

from fsw.config import Config
from fsw.estimators.model.problem import Problem, build_problem, present
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, Estimate, FloatArray


class TorqueResiduals:
    """Root mean square over a window's instants, per joint in the configuration's order [N m].

    Raises
    ------
    ConfigError when the robot cannot be read.
    """

    def __init__(self, config: Config) -> None:
        model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
        self._problem: Problem = build_problem(config, model)
        names = [joint.name for joint in config.joints]
        self._places = [model.joint_names.index(name) for name in names]

    def of(self, block: Block, estimate: Estimate) -> list[float]:
        """Return the residuals; none without all sensors, or of an estimate of other states."""
        complete = block.has_gyro and block.has_accelerometer and bool(np.all(block.has_joint))
        if not complete or estimate.names != self._problem.names:
            return []
        problem, x = self._problem, estimate.mean
        pi = problem.pi(x)
        errors = np.stack([self._errors(block, k, x, pi) for k in range(len(block.t_ns))])
        rms = np.sqrt(np.mean(errors**2, axis=0))
        return [float(rms[place]) for place in self._places]

    def _errors(self, block: Block, k: int, x: FloatArray, pi: FloatArray) -> FloatArray:
        """Return measured less modelled torque at one instant (n,).

        The base's acceleration is the specific force at the accelerometer taken to B's origin:
        a_B = f - wd x p - w x (w x p), in free fall (eq. (3) of the paper).
        """
        problem = self._problem
        w, wd, f = block.w_NB_B_rad_s[k], block.wd_NB_B_rad_s2[k], block.f_NS_B_m_s2[k]
        if present(problem.gyro_bias):
            w = w - x[problem.gyro_bias]
        if present(problem.acc_bias):
            f = f - x[problem.acc_bias]
        p = problem.p_BS_m
        acceleration = f - np.cross(wd, p) - np.cross(w, np.cross(w, p))
        a = np.concatenate([acceleration, wd, block.qdd_rad_s2[k]])
        Y = problem.model.regressor(block.q_rad[k], w, block.qd_rad_s[k], a)
        modelled = Y[6:] @ pi
        if present(problem.torque_offset):
            modelled = modelled + x[problem.torque_offset]
        error: FloatArray = block.tau_nm[k] - modelled
        return error
