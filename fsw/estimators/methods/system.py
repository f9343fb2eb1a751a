"""What the batch methods solve for: the problem's states and more nuisances, ready for the kernels.

The states are the problem's: bodies, then the nuisances it has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fsw.estimators.kernel import Arm, build_arm
from fsw.estimators.methods.layout import Columns, Data
from fsw.estimators.model.inertia import PARAMETERS
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.problem import Problem, present
from fsw.estimators.samples import SampleSet
from fsw.messages import FloatArray
from fsw.messages.errors import EstimatorError

Weighting = Literal["ols", "wls", "compensated", "eiv"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options:
    """How a batch method runs."""

    weighting: Weighting = "eiv"  # MRNEA only
    body_prior: bool = True  # False: the bodies' prior is a start, not information
    start: FloatArray | None = None  # bodies' parameters to start from; None: the prior
    max_iterations: int = 60
    condition_limit: float = 1e8
    energy_interval: int = 10  # samples per energy balance (CE)
    wanted_accuracy: float = 0.02  # 1 sigma of the masses, relative, for the verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class System:
    """Constants of one batch run."""

    problem: Problem
    arm: Arm
    change: FloatArray  # (n+1, 10, 10)
    at: Columns
    names: tuple[str, ...]
    prior_mean: FloatArray
    prior_information: FloatArray  # zero for the bodies without a prior
    prior_covariance: FloatArray  # with the bodies' prior, always

    def bodies(self, x: FloatArray) -> FloatArray:
        """Return pi of base and links (n+1, 10) in the kernel's frames for the state x."""
        pi = self.problem.pi(x).reshape(-1, PARAMETERS)
        turned: FloatArray = np.einsum("bij,bj->bi", self.change, pi)
        return turned

    def with_bodies(self, values: FloatArray | None) -> FloatArray:
        """Return the prior mean with other body parameters."""
        x = self.prior_mean.copy()
        if values is not None:
            x[self.problem.bodies] = values[self.problem.bodies]
        return x


def build_system(problem: Problem, options: Options) -> System:
    """Lay out states and prior of a batch run.

    Raises
    ------
    EstimatorError for a wrench on the target, which the compiled passes do not know.
    """
    if present(problem.target_wrench):
        raise EstimatorError("a wrench on the target is estimated from blocks only")
    model = problem.model
    arm, change = build_arm(model)
    p, covariance = len(problem.names), problem.prior_covariance
    information = np.zeros((p, p))
    free = slice(0 if options.body_prior else problem.bodies.stop, p)
    information[free, free] = np.linalg.solve(covariance[free, free], np.eye(p)[free, free])
    at = Columns(
        base=_first(problem.body("base")) if "base" in problem.unknown else -1,
        target=_first(problem.body("target")) if "target" in problem.unknown else -1,
        torque_offset=_first(problem.torque_offset),
        acc_bias=_first(problem.acc_bias),
        gyro_bias=_first(problem.gyro_bias),
        momentum=_first(problem.momentum),
        torque_scale=_first(problem.torque_scale),
        wrench=_first(problem.wrench),
    )
    return System(
        problem=problem,
        arm=arm,
        change=change,
        at=at,
        names=problem.names,
        prior_mean=problem.prior_mean,
        prior_information=0.5 * (information + information.T),
        prior_covariance=covariance,
    )


def _first(states: slice) -> int:
    return int(states.start) if states.stop > states.start else -1


def _zenith(samples: SampleSet, orbit: CircularOrbit) -> FloatArray:
    """Return sqrt(3 mu/R^3) times the unit vector from the Earth, in base axes (N, 3)."""
    angle = orbit.gradient_1_s2**0.5 * samples.t_s
    r_N = np.outer(np.cos(angle), orbit.r_hat) + np.outer(np.sin(angle), orbit.t_hat)
    r_B: FloatArray = np.einsum("kji,kj->ki", samples.R_NB, r_N)
    return np.ascontiguousarray((3.0 * orbit.gradient_1_s2) ** 0.5 * r_B)


def kernel_data(samples: SampleSet, orbit: CircularOrbit | None = None) -> Data:
    """Return the arrays of a sample set as the kernels take them; its times are from the epoch."""
    noise = samples.noise
    v = np.zeros((0, 3)) if samples.v_NB_B is None else samples.v_NB_B
    return Data(
        samples.t_s,
        samples.q,
        samples.qd,
        samples.qdd,
        samples.tau,
        samples.w_NB_B,
        samples.wd_NB_B,
        samples.a_NB_B,
        v,
        samples.R_NB,
        np.zeros((0, 3)) if orbit is None else _zenith(samples, orbit),
        noise.tau_nm,
        noise.qdd_rad_s2,
        noise.w_rad_s,
        noise.wd_rad_s2,
        noise.a_m_s2,
        noise.v_m_s,
    )
