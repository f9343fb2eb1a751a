"""The attitude's quadrature and its gradient."""

import numpy as np

from planner import attitude

STEP_S = 0.4


def angles(w):
    R = attitude.attitudes(w, STEP_S)
    return 0.5 * np.sum(attitude.excursions(R) ** 2, axis=1)


def test_a_constant_rate_turns_by_its_integral():
    w = np.tile([0.02, -0.01, 0.03], (20, 1))
    phi = attitude.excursions(attitude.attitudes(w, STEP_S))
    np.testing.assert_allclose(phi[-1], 20 * STEP_S * w[0], atol=1e-12)


def test_the_gradient_is_that_of_the_angle():
    rng = np.random.default_rng(0)
    w, w_by_z = 0.2 * rng.standard_normal((12, 3)), rng.standard_normal((12, 3, 5))
    R = attitude.attitudes(w, STEP_S)
    phi = attitude.excursions(R)
    exact = attitude.half_square_gradient(w, R, phi, STEP_S, w_by_z)
    direction, h = rng.standard_normal(5), 1e-6
    change = w_by_z @ direction
    numeric = (angles(w + h * change) - angles(w - h * change)) / (2 * h)
    np.testing.assert_allclose(exact @ direction, numeric, rtol=1e-7, atol=1e-9)


def test_the_right_jacobian_is_smooth_at_zero():
    phi = np.array([[0.0, 0.0, 0.0], [9e-4, 0.0, 0.0], [1.1e-3, 0.0, 0.0]])
    J = attitude.right_jacobian(phi)
    np.testing.assert_allclose(J[0], np.eye(3))
    np.testing.assert_allclose((J[1] - np.eye(3)) / 9e-4, (J[2] - np.eye(3)) / 1.1e-3, atol=1e-3)
