"""Columns of the Jacobian of predicted channels against central differences."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from fsw.messages import FloatArray

FIELDS = {"tau_nm": "J_tau", "f_m_s2": "J_f", "w_rad_s": "J_w"}


def predicted_fields(rate: str) -> Mapping[str, str]:
    """Return the predicted channels and their Jacobians; a measured rate is not predicted."""
    return {k: J for k, J in FIELDS.items() if not (rate == "measured" and k == "w_rad_s")}


def assert_state_slopes(
    predicted: Callable[[FloatArray], Any],
    x: FloatArray,
    step: Callable[[int], float],
    *,
    rtol: float,
    of_slope: float,
    rounding: float,
    fields: Mapping[str, str] = FIELDS,
    states: Iterable[int] | None = None,
) -> None:
    """Assert that the columns of `states` (None: all) are derivatives of `predicted` at x (p,).

    An element may differ by `rtol` of itself, `of_slope` of the largest one, and `rounding` of the
    largest value over the step.
    """
    found = predicted(x)
    for k in range(len(x)) if states is None else states:
        h = step(k)
        d = h * np.eye(len(x))[k]
        up, down = predicted(x + d), predicted(x - d)
        for name, jacobian in fields.items():
            slope = (getattr(up, name) - getattr(down, name)) / (2.0 * h)
            atol = of_slope * np.abs(slope).max() + rounding * np.abs(getattr(up, name)).max() / h
            got = getattr(found, jacobian)[:, :, k]
            np.testing.assert_allclose(got, slope, rtol=rtol, atol=atol, err_msg=f"{name}, {k}")
