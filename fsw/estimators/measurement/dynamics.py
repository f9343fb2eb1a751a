"""Mass matrix, forces and regressors at the base motion that the joints' motion predicts.

Equations and symbols are those of `fused`.
"""

from dataclasses import dataclass

import numpy as np

from fsw.estimators.effects.carried import Carried
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import external_force, pulled
from fsw.estimators.measurement.mounting import gyro_turn, needs_angle_columns
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics:
    """Mass matrix, velocity derivative and regressors at the nodes' predicted base motion."""

    H: FloatArray  # (m, 6+t, 6+n), t torques: of n joints, then the axes of wrench sensors
    H_bb_inverse: FloatArray  # (m, 6, 6)
    C: FloatArray  # (m, 6+t, 6+n)
    Y: FloatArray  # (m, 6+t, k) at the predicted acceleration, columns of the inertial states
    Y_h: FloatArray | None  # (m, 6, k) momentum regressor, where the rate is predicted by it
    nu: FloatArray  # (m, 6) predicted base velocity
    a: FloatArray  # (m, 6) predicted base acceleration
    force: FloatArray  # (m, t) torque
    carried: Carried | None
    by_angle: FloatArray | None  # (m, 6+t, n) d(generalised force)/dq, where angles are noisy
    h_by_angle: FloatArray | None  # (m, 6, n) d(base momentum)/dq


def dynamics(
    s: BlockStack,
    x: FloatArray,
    problem: Problem,
    rate: Rate,
    given: tuple[FloatArray, FloatArray, Carried | None],
) -> Dynamics:
    """Evaluate the model at the nodes.

    `given`: angular momentum of base and arm (N, 3) in B, gravity gradient (N, 3, 3), and what
    momentum is carried besides.

    Raises
    ------
    numpy.linalg.LinAlgError if the base's inertia is not positive definite at these parameters.
    """
    model, n, N = problem.model, s.n, len(s.q_rad)
    L_B, G, carried = given
    pi = problem.pi(x)
    model.set_parameters(pi)
    q, qd = s.q_rad, s.qd_rad_s
    H = model.mass_matrices(q)
    inverse = _yielding(H[:, :6, :6], problem)
    nu, a = np.zeros((2, N, 6 + n))
    nu[:, 6:], a[:, 6:] = qd, s.qdd_rad_s2
    momentum = -times(H[:, :6, 6:], qd)
    momentum[:, 3:] += L_B
    nu[:, :6] = times(inverse, momentum)
    Y_h = None
    if rate == "measured":
        nu[:, 3:6] = s.w_NB_B_rad_s
        if problem.has("gyro_bias"):
            nu[:, 3:6] -= x[problem.at("gyro_bias")]
        nu[:, 3:6] = nu[:, 3:6] @ gyro_turn(x, problem).T
    else:
        Y_h = model.momentum_regressors(q, nu)[:, :6] @ problem.U
    w = nu[:, 3:6]
    C, force = model.forces_and_derivatives(q, w, qd, a)  # of a base that does not accelerate
    Y_field = None
    if problem.orbit is not None:
        Y_field = model.field_regressors(q, G)
        force -= Y_field @ pi
    if pulled(problem):
        force -= external_force(s, x, problem)[0]
    if carried is not None:
        force[:, 3:6] += carried.moment(w)
        C[:, 3:6, 3:6] += carried.by_rate()
    a[:, :6] = -times(inverse, force[:, :6])
    if problem.support_m_s2.any():
        held = np.concatenate([problem.support_m_s2, np.zeros(3)])
        a[:, :6] += held - times(inverse, H[:, :6, :6] @ held)
    Y = model.regressors(q, w, qd, a)
    if Y_field is not None:
        Y -= Y_field
    by_angle = h_by_angle = None
    needed = problem.angles_are_noisy or needs_angle_columns(problem)
    if needed or problem.has("mode_start"):
        by_angle = model.angle_derivatives(q, w, qd, a)
        h_by_angle = model.momentum_derivatives(q, nu)
    return Dynamics(
        H=H,
        H_bb_inverse=inverse,
        C=C,
        Y=Y @ problem.U,
        Y_h=Y_h,
        nu=nu[:, :6],
        a=a[:, :6],
        force=force[:, 6:] + times(H[:, 6:, :6], a[:, :6]),
        carried=carried,
        by_angle=by_angle,
        h_by_angle=h_by_angle,
    )


def _yielding(H_bb: FloatArray, problem: Problem) -> FloatArray:
    """Return (N, 6, 6): the base's acceleration by a force; H_bb^-1 if the base is free.

    With the free motions S it is S (S^T H_bb S)^-1 S^T: the support bears the rest of the force.

    Raises
    ------
    numpy.linalg.LinAlgError if the inertia of a free motion is not positive.
    """
    S = problem.freedom
    own = H_bb if problem.is_free else S.T @ H_bb @ S
    np.linalg.cholesky(own)  # raises
    inverse = np.asarray(np.linalg.solve(own, np.eye(S.shape[1])), np.float64)
    return inverse if problem.is_free else np.asarray(S @ inverse @ S.T, np.float64)


def times(A: FloatArray, v: FloatArray) -> FloatArray:
    """Return A v at every node, A (N, r, k), v (N, k)."""
    product: FloatArray = (A @ v[:, :, None])[:, :, 0]
    return product
