"""Valid outputs and wrong ones, of estimates made by hand."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from fsw.messages import Estimate
from hil.judge.outcome import outputs, worst


@dataclass
class _Body:
    mass_kg: float
    mass_sigma_kg: float = 2.0
    com_m: Any = (0.1, 0.2, 0.3)
    com_sigma_m: Any = (0.01, 0.01, 0.01)
    inertia_kg_m2: Any = (5.0, 0.0, 0.0, 6.0, 0.0, 7.0)
    inertia_sigma_kg_m2: Any = (1.0,) * 6


@dataclass
class _Estimate:
    valid: bool
    bodies: dict[str, _Body]


TRUTH = {"target": np.array([100.0, 0.1, 0.2, 0.3, 5, 0, 0, 6, 0, 7])}


def _estimate(mass_kg: float, *, valid: bool = True) -> Estimate:
    return cast(Estimate, _Estimate(valid, {"target": _Body(mass_kg)}))


def test_wrong_is_what_is_valid_and_beyond_five_sigma() -> None:
    right, bad = _estimate(109.9), _estimate(110.1)
    assert outputs([right, bad, _estimate(200.0, valid=False)], TRUTH) == {"valid": 2, "wrong": 1}


def test_worst_is_the_largest_of_all_figures() -> None:
    body = _Body(102.0, com_m=(0.1, 0.2, 0.37))
    assert worst(cast(Any, {"target": body}), TRUTH) == pytest.approx(7.0)
