"""Jacobians of predicted channels and of rows against central differences."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray

TORQUE = {"tau_nm": "J_tau"}
FIELDS = {"tau_nm": "J_tau", "f_m_s2": "J_f", "w_rad_s": "J_w"}


def predicted_fields(rate: str) -> Mapping[str, str]:
    """Return the predicted channels and their Jacobians; a measured rate is not predicted."""
    return {k: J for k, J in FIELDS.items() if not (rate == "measured" and k == "w_rad_s")}


def assert_state_slopes(
    predicted: Callable[[FloatArray], Any],
    x: FloatArray,
    step: Callable[[int], float] | float,
    *,
    rtol: float,
    of_slope: float,
    rounding: float = 0.0,
    absolute: float = 0.0,
    fields: Mapping[str, str] = FIELDS,
    states: Iterable[int] | None = None,
) -> None:
    """Assert that the columns of `states` (None: all) are derivatives of `predicted` at x (p,).

    An element may differ by `rtol` of itself, `of_slope` of the largest one, `rounding` of the
    largest value over the step, and `absolute`.
    """
    found = predicted(x)
    for k in range(len(x)) if states is None else states:
        h = step(k) if callable(step) else step
        d = h * np.eye(len(x))[k]
        up, down = predicted(x + d), predicted(x - d)
        for name, jacobian in fields.items():
            slope = (getattr(up, name) - getattr(down, name)) / (2.0 * h)
            atol = of_slope * np.abs(slope).max() + rounding * np.abs(getattr(up, name)).max() / h
            atol += absolute
            got = getattr(found, jacobian)[:, :, k]
            np.testing.assert_allclose(got, slope, rtol=rtol, atol=atol, err_msg=f"{name}, {k}")


def assert_row_slopes(
    rows: Callable[[FloatArray], Any],
    x: FloatArray,
    h: float,
    states: Iterable[int],
    *,
    of_slope: float,
    rounding: float = 0.0,
) -> None:
    """Assert that A = -db/dx in the columns of `states` of `rows` at x (p,)."""
    A = rows(x).A
    for k in states:
        up, down = (rows(x + s * np.eye(len(x))[k]).b for s in (h, -h))
        slope = (down - up) / (2.0 * h)
        bound = of_slope * np.abs(slope).max() + rounding * np.abs(up).max() / h
        assert np.abs(A[:, k] - slope).max() <= bound, k


def assert_motion_slopes(
    predicted: Callable[[Block], Any], block: Block, key: str, gain: str
) -> None:
    """Assert that `gain` is the derivative of the torques by the joints' motion `key`."""
    h, n = 1e-6, block.tau_nm.shape[1]
    D = getattr(predicted(block), gain)[:, :n]
    for j in range(n):
        step = h * np.eye(n)[j]
        up, down = (
            predicted(replace(block, **{key: getattr(block, key) + s * step})).tau_nm
            for s in (1.0, -1.0)
        )
        assert np.abs(D[:, :, j] - (up - down) / (2.0 * h)).max() <= 1e-5 * np.abs(D).max()


def off_the_prior(problem: Problem, size: float = 1.0) -> FloatArray:
    """Return the prior mean with all states but those of the bodies off by `size` sigmas."""
    sigma, x = np.sqrt(np.diag(problem.prior_covariance)), problem.prior_mean.copy()
    free = slice(problem.bodies.stop, len(x))
    x[free] += size * sigma[free] * np.random.default_rng(3).normal(size=len(x[free]))
    return x


def named(problem: Problem, *starts: str) -> list[int]:
    """Return the states whose names begin with one of `starts`."""
    return [k for k, name in enumerate(problem.names) if name.startswith(starts)]
