"""Parameter conventions of the bench's scoring."""

import numpy as np
import pinocchio as pin
import pytest

from hil.world.inertia import (
    frame_map,
    is_physical,
    pi_jacobian,
    pi_of,
    report_covariance,
    report_of,
)

GEO = np.array([1200, 1.5, 1.25, 1.4, 1058, 20, 30, 920, -8, 750.0])


def test_pi_agrees_with_pinocchio():
    inertia = pin.Inertia(
        1200.0,
        np.array([1.5, 1.25, 1.4]),
        np.array([[1058, 20, 30], [20, 920, -8], [30, -8, 750.0]]),
    )
    np.testing.assert_allclose(pi_of(GEO), inertia.toDynamicParameters(), rtol=1e-13)


def test_report_is_the_inverse_of_pi():
    np.testing.assert_allclose(report_of(pi_of(GEO)), GEO, rtol=1e-12)


def test_jacobian_matches_central_differences():
    steps = 1e-5 * np.maximum(1.0, np.abs(GEO))
    columns = [
        (pi_of(GEO + step * unit) - pi_of(GEO - step * unit)) / (2 * step)
        for step, unit in zip(steps, np.eye(10), strict=True)
    ]
    np.testing.assert_allclose(pi_jacobian(GEO), np.stack(columns, 1), rtol=1e-6, atol=1e-6)


def test_report_covariance_undoes_the_jacobian():
    sigma = np.linspace(0.1, 1.0, 10)
    J = pi_jacobian(GEO)
    covariance = report_covariance(pi_of(GEO), J @ np.diag(sigma**2) @ J.T)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=1e-8)


def test_frame_map_agrees_with_pinocchio():
    placement = pin.SE3(pin.exp3(np.array([0.3, -0.7, 1.1])), np.array([0.2, -0.4, 0.9]))
    inertia = pin.Inertia.FromDynamicParameters(pi_of(GEO))
    expected = placement.act(inertia).toDynamicParameters()
    mapped = frame_map(placement.rotation, placement.translation) @ pi_of(GEO)
    np.testing.assert_allclose(mapped, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize(
    ("moments", "physical"),
    [((2.0, 3.0, 4.0), True), ((1.0, 1.0, 2.1), False), ((-1.0, 2.0, 2.0), False)],
)
def test_triangle_inequality_decides_what_is_physical(moments, physical):
    xx, yy, zz = moments
    assert is_physical(np.array([10.0, 0, 0, 0, xx, 0, 0, yy, 0, zz])) is physical
