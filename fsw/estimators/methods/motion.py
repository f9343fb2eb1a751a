"""Maximum likelihood over a motion known through noisy angles alone.

The joints' angles, rates and accelerations are one curve, linear in a few coefficients, fitted to
the angles. Its errors last, and stand in all three alike: taken as exact, or as white errors of the
accelerations, they make the estimate far surer than it is. So the coefficients become states, the
fit their prior, and torque, rate and specific force inform the motion as well as the bodies.
Source: errors in variables by their latent values, Gull (1989) in Maximum Entropy and Bayesian
Methods; Fuller, Measurement Error Models (1987), sec. 3.1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsw.estimators.methods.layout import Channels
from fsw.estimators.methods.levenberg import Minimum, minimise
from fsw.estimators.methods.motion_pass import motion_gradient, row_pass
from fsw.estimators.methods.system import System, kernel_data
from fsw.estimators.samples import JointCurve, SampleSet
from fsw.messages import FloatArray


def refine(
    samples: SampleSet,
    curve: JointCurve,
    system: System,
    use: Channels,
    start: FloatArray,
    max_iterations: int,
) -> Minimum:
    """Minimise over bodies, nuisances and the curve's coefficients; return without the latter.

    The information is that of the data with the curve eliminated.
    """
    p, size = len(start), curve.coefficients.size
    whole = p + size
    information, covariance = np.zeros((whole, whole)), np.zeros((whole, whole))
    n = curve.coefficients.shape[1]
    covariance[:p, :p] = system.prior_covariance
    covariance[p:, p:] = np.kron(curve.covariance, np.eye(n))
    information[:p, :p] = system.prior_information
    information[p:, p:] = np.kron(curve.information(), np.eye(n))
    mean = np.concatenate([system.prior_mean, curve.coefficients.ravel()])
    joined = replace(
        system, prior_mean=mean, prior_information=information, prior_covariance=covariance
    )
    first = np.concatenate([start, curve.coefficients.ravel()])
    found = minimise(_MotionPass(samples, curve, system, use), joined, first, max_iterations)
    total = found.information + information
    eliminated = np.linalg.solve(total[p:, p:], total[p:, :p])
    own = found.information[:p, :p] - total[:p, p:] @ eliminated
    return replace(
        found,
        x=found.x[:p],
        information=0.5 * (own + own.T),
        gradient=found.gradient[:p],
    )


class _MotionPass:
    """The Gram matrix as a function of state and coefficients."""

    def __init__(
        self, samples: SampleSet, curve: JointCurve, system: System, use: Channels
    ) -> None:
        data = kernel_data(samples, system.problem.orbit)
        self._data = data._replace(s_qdd=np.zeros(samples.n))
        self._basis, self._system, self._use = curve.basis, system, use
        self._shape = curve.coefficients.shape

    def __call__(self, state: FloatArray) -> FloatArray:
        system = self._system
        p = len(system.prior_mean)
        x = np.ascontiguousarray(state[:p])
        q, qd, qdd = self._basis @ state[p:].reshape(self._shape)
        data = self._data._replace(q=q, qd=qd, qdd=qdd)
        given = (system.arm, system.bodies(x), x, system.at, data, self._use)
        rows = row_pass(*given)
        by_motion = motion_gradient(*given)
        by_curve = np.einsum("imdj,dia->imaj", by_motion, self._basis, optimize=True)
        N, m = rows.shape[:2]
        A = np.concatenate(
            [rows[:, :, :p], by_curve.reshape(N, m, -1), rows[:, :, p:]], axis=2
        ).reshape(N * m, -1)
        return np.asarray(A.T @ A)
