"""The base's attitude since the start: the quadrature of its rate, and its derivative.

With zero momentum the rate is an algebraic function of the joint motion, so the attitude is a
product of rotations R_k+1 = R_k exp(h [w_k x]), with rates at the middle of equal steps h. A change
of one rate changes all later attitudes. With phi_k = log R_k+1, R_k+1 phi_k = phi_k, therefore

    d |phi_k|^2 / 2 = phi_k . sum_{i <= k} h R_i+1 J_r(h w_i) dw_i
"""

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.estimators.model.inertia import skew
from fsw.messages import FloatArray


def attitudes(w_B: FloatArray, step_s: float | FloatArray) -> FloatArray:
    """Return attitudes (m, 3, 3) at the ends of steps [s] from rates w_B (m, 3) at their middle."""
    steps = Rotation.from_rotvec(step_s * w_B).as_matrix()
    R, result = np.eye(3), np.empty_like(steps)
    for k, step in enumerate(steps):
        R = R @ step
        result[k] = R
    return result


def excursions(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (m, 3) [rad] of attitudes R (m, 3, 3) since the start."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def half_square_gradient(
    w_B: FloatArray, R: FloatArray, phi: FloatArray, step_s: float, w_by_z: FloatArray
) -> FloatArray:
    """Return d(|phi_k|^2 / 2)/dz (m, v) from dw/dz (m, 3, v)."""
    turned = step_s * R @ right_jacobian(step_s * w_B) @ w_by_z
    return np.asarray(np.einsum("ki,kiv->kv", phi, np.cumsum(turned, axis=0)))


def right_jacobian(phi: FloatArray) -> FloatArray:
    """Return the right Jacobian J_r (m, 3, 3) of SO(3): exp(phi + d) = exp(phi) exp(J_r d).

    Source: Sola, Deray, Atchuthan (2018), eq. (143).
    """
    angle2 = np.sum(phi * phi, axis=-1)[..., None, None]
    S = skew(phi)
    small = angle2 < 1e-6
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    first = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(angle)) / safe)
    second = np.where(small, 1 / 6 - angle2 / 120, (angle - np.sin(angle)) / (safe * angle))
    return np.asarray(np.eye(3) - first * S + second * (S @ S))
