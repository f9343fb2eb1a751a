"""A prior is contradicted by what the data show, not by how widely their sigma is stated."""

from typing import Any

import numpy as np
import pytest

from fsw.estimators.recursive import recursion as module
from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import make_config, noisy_blocks, robot_model


def test_a_prior_is_judged_by_the_covariance_whose_mean_the_estimate_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Likeness and creep widen what is stated; the step from the prior is as large as before."""
    online = build_online(make_config(), robot_model())
    for block in noisy_blocks("target", 1, 8.0):
        online.push(block)
    own, used = online.recursion, []

    def seen(_: Any, prior: Any, estimate: Any) -> Any:
        used.append(estimate)
        return prior[1], []

    monkeypatch.setattr(module, "widen", seen)
    own._check_prior()
    monkeypatch.setattr(own.trust, "widened", lambda covariance, _: 4.0 * covariance)
    own._check_prior()
    (x, alone), (y, wider) = used
    np.testing.assert_array_equal(alone, wider)
    np.testing.assert_array_equal(x, y)
    information = own.memory.tempered(own.monitor.variance)
    np.testing.assert_allclose(x, information.mean(), rtol=1e-9, atol=1e-12)
