"""RDA: the reduced dynamics algorithm (paper eqs. 22-27) without translational base velocity.

The base acceleration is eliminated, tau = H^ qdd + C^ with H^ = H_m - H_bm^T H_bb^-1 H_bm; v_b
cancels exactly (see model/robot.py). Noise of the joint accelerations and of the measured
rate is weighed in, (Sigma_tau + H^ Sigma_qdd H^^T + D Sigma_w D^T)^-1.
"""

from __future__ import annotations

from fsw.estimators.methods.fused_batch import solve_channels
from fsw.estimators.methods.layout import Channels
from fsw.estimators.methods.result import BatchResult
from fsw.estimators.methods.system import Options
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet

RDA = Channels(torque=True, accelerometer=False, gyro=False, velocity=False, measured_rate=True)


def solve_rda(samples: SampleSet, problem: Problem, options: Options) -> BatchResult:
    """Estimate from joint torques, joint motion and the measured base rate."""
    return solve_channels(samples, problem, options, RDA, "rda")
