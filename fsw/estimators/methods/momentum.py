"""CM: conservation of momentum (paper eqs. 30-31), v_b eliminated by zero linear momentum.

The rows are homogeneous in the parameters: the known arm alone fixes the scale. The paper's
reading, six rows with the true v_b and its noise, is for the study: no flight sensor gives v_b.
"""

from __future__ import annotations

from fsw.estimators.methods.fused_batch import solve_channels
from fsw.estimators.methods.layout import Channels
from fsw.estimators.methods.result import BatchResult
from fsw.estimators.methods.system import Options
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet

GYRO = Channels(torque=False, accelerometer=False, gyro=True, velocity=False, measured_rate=False)


def solve_momentum(samples: SampleSet, problem: Problem, options: Options) -> BatchResult:
    """Estimate from the measured base rate and, where the samples have it, the base velocity."""
    use = GYRO._replace(velocity=samples.v_NB_B is not None)
    return solve_channels(samples, problem, options, use, "cm")
