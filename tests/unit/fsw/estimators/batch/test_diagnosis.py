"""What a batch result says about itself: against the bound of all sensors, in numbers and words."""

import json
from typing import Any

import numpy as np
import pytest

from fsw.estimators.batch.run import run_batch
from fsw.estimators.diagnosis import whiteness
from tests.support.estimator_cases import make_config, noisy_blocks


def batch(method: str, **options: Any) -> dict[str, Any]:
    config = make_config(("target",), **options)
    result = run_batch(config, noisy_blocks("target", 1, 24.0), method, ("target",))
    plain: dict[str, Any] = json.loads(json.dumps(result))
    return plain


def test_fused_reaches_the_bound_it_is_measured_by() -> None:
    """Fisher information and covariance come from the same rows by two ways: equal to 1e-6."""
    result = batch("fused")
    told = result["diagnosis"]
    sigma = np.sqrt(np.diag(result["covariance"]))
    assert told["crb_sigma"] == pytest.approx(sigma, rel=1e-6)
    assert told["efficiency_volume"] == pytest.approx(1.0, rel=1e-6)
    assert told["verdict"]["target"].startswith("target mass identified to")
    assert abs(told["innovation_lag1"]["correlation"]) < told["innovation_lag1"]["bound"]
    assert told["noise_ratio"] == pytest.approx(1.0, abs=0.1)
    assert told["known_combinations"] >= 10
    assert len(told["correlation"]) == len(result["names"])
    assert 1.0 <= result["condition_number"] < 1e8
    assert 20.0 < result["duration_s"] <= 24.0


@pytest.mark.parametrize("method", ["mrnea", "rda", "cm"])
def test_a_method_of_fewer_sensors_tells_what_it_wastes(method: str) -> None:
    result = batch(method)
    told = result["diagnosis"]
    sigma = np.sqrt(np.diag(result["covariance"]))
    assert np.all(np.array(told["crb_sigma"]) <= sigma * (1 + 1e-9))
    assert told["efficiency_volume"] < 0.999
    assert told["efficiency_trace"] <= 1.0 + 1e-9


def test_whiteness_of_repeated_and_of_independent_residuals() -> None:
    rng = np.random.default_rng(0)
    white = [rng.normal(size=40) for _ in range(100)]
    correlation, bound = whiteness(white)
    assert abs(correlation) < bound < 0.06
    assert whiteness([white[0]] * 5)[0] == pytest.approx(1.0)
    assert whiteness([white[0], white[1][:3]]) == (0.0, 1.0)
