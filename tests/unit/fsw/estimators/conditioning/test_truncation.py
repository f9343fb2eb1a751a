"""What a window's polynomial leaves out, against the Legendre series of sinusoids."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.special import spherical_jn

from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.conditioning.truncation import OMITTED, coefficients, legendre_basis, omitted

M, HALF_S, SAMPLES = 4, 0.2, 200
DEGREE = M + 2
T_S = ((np.arange(SAMPLES) + 0.5) / SAMPLES * 2.0 - 1.0) * HALF_S


def fitted(q, degree=DEGREE):
    """Return [qd, qdd, q] (3, m, 1) at the nodes by the fit of samples q (k,)."""
    fit = NodeFit(T_S, HALF_S, degree, M)
    return (fit.operators((1, 2, 0)) @ fit.coefficients(q[:, None])).reshape(3, M, 1)


def omitted_of(q, sigma):
    """Return the covariance (3 m, 3 m) of what the fit of samples q (k,) leaves out."""
    coefficients_of = np.polynomial.legendre.legfit(T_S / HALF_S, q, DEGREE)
    left = q - np.polynomial.legendre.legval(T_S / HALF_S, coefficients_of)
    products = np.array([[left @ left], [left[1:] @ left[:-1]]]) / SAMPLES
    return omitted(fitted(q), DEGREE, HALF_S, np.array([sigma]), SAMPLES, products)[0]


def size(covariance):
    """Return the sigma of each omitted coefficient that a covariance (3 m, 3 m) states."""
    phi = legendre_basis(M, DEGREE + OMITTED, HALF_S)[:, :, -OMITTED:].reshape(3 * M, OMITTED)
    return np.sqrt(np.trace(covariance) / np.trace(phi @ phi.T))


def test_coefficients_are_those_of_the_polynomial():
    p = Polynomial(np.random.default_rng(1).normal(size=DEGREE + OMITTED + 1))
    t = HALF_S * gauss_nodes(M)
    z = np.stack([p.deriv()(t), p.deriv(2)(t), p(t)])
    got = np.einsum("cdi,di->c", coefficients(M, DEGREE + OMITTED, HALF_S), z)
    want = np.polynomial.legendre.poly2leg(p(Polynomial([0.0, HALF_S])).coef)
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("phase", np.linspace(0.0, np.pi, 7).tolist())
def test_of_a_sinusoid_it_is_not_too_small(rate_hz, phase):
    """cos(w t + phase) has coefficients (2 j + 1) j_j(w h) times cosine or sine of the phase."""
    w = 2.0 * np.pi * rate_hz
    true = [
        (2 * j + 1) * spherical_jn(j, w * HALF_S) * (np.cos(phase) if j % 2 == 0 else np.sin(phase))
        for j in (DEGREE + 1, DEGREE + 2)
    ]
    found = size(omitted_of(np.cos(w * T_S + phase), 1e-12))
    assert np.linalg.norm(true) < 2.0 * found
    assert found < 30.0 * (2 * DEGREE + 3) * spherical_jn(DEGREE + 1, w * HALF_S)


@pytest.mark.parametrize("declared", [1.0, 0.01])
@pytest.mark.parametrize("seed", range(5))
def test_noise_omits_next_to_nothing(seed, declared):
    """A slow motion with noise: less than a tenth of the noise of a coefficient."""
    sigma = 1e-4
    rng = np.random.default_rng(seed)
    q = 0.3 * np.sin(1.2 * T_S + seed) + sigma * rng.normal(size=SAMPLES)
    found = size(omitted_of(q, declared * sigma))
    assert found < 0.1 * sigma * np.sqrt((2 * DEGREE + 3) / SAMPLES)


def test_a_stop_in_a_window_omits_as_much_as_it_fits():
    """A rate that ends at once falls so slowly that the edges may be off by its highest terms."""
    q = np.minimum(T_S, 0.03)
    found = omitted_of(q, 1e-9)
    fit = np.polynomial.legendre.legfit(T_S / HALF_S, q, DEGREE)
    assert size(found) > 0.2 * np.abs(fit[-2:]).max()


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("since_s", np.linspace(-0.17, 0.17, 9).tolist())
def test_of_a_start_within_a_window_it_is_not_too_small(order, since_s):
    """A step of acceleration, jerk or snap: every error at the nodes is below 4 sigma."""

    def motion(t_s):
        late = np.maximum(t_s - since_s, 0.0)
        return [order * late ** (order - 1), order * (order - 1) * late ** (order - 2), late**order]

    error = (fitted(motion(T_S)[2]) - np.stack(motion(HALF_S * gauss_nodes(M)))[:, :, None]).ravel()
    if order == 2:
        error[M : 2 * M] = 0.0  # the step itself is no polynomial's
    sigma = np.sqrt(np.diag(omitted_of(motion(T_S)[2], 1e-12)))
    assert np.all(np.abs(error) < 4.0 * sigma)
