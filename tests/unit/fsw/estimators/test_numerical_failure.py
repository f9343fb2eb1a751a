"""Arithmetic that fails is a reset with its event, or an error with words; never a traceback."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.estimators.batch import run as batch_run
from fsw.estimators.batch import solver
from fsw.estimators.batch.run import run_batch
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block
from fsw.messages.errors import EstimatorError
from tests.support.estimator_cases import (
    NODES,
    SENSOR_B_M,
    draw_biases,
    make_config,
    motion,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
)


def throw(rate_rad_s: float, count: int) -> list[Block]:
    """Return blocks of a robot with its arm at rest that tumbles at a constant rate."""
    rng = np.random.default_rng(0)
    w = rng.normal(size=3)
    w *= rate_rad_s / np.linalg.norm(w)
    force = np.cross(w, np.cross(w, np.array(SENSOR_B_M)))
    blocks = []
    for k in range(count):
        block = true_block(motion("base"), 3.0 + 0.4 * k, k)
        zero = np.zeros_like(block.q_rad)
        still = replace(
            block,
            q_rad=zero,
            qd_rad_s=zero,
            qdd_rad_s2=zero,
            tau_nm=zero,
            w_NB_B_rad_s=np.tile(w, (NODES, 1)),
            wd_NB_B_rad_s2=np.zeros((NODES, 3)),
            f_NS_B_m_s2=np.tile(force, (NODES, 1)),
            R_NB=Rotation.from_rotvec(np.outer(block.t_ns * 1e-9, w)).as_matrix(),
        )
        blocks.append(noisy(still, rng, draw_biases(rng)))
    return blocks


def test_a_throw_with_much_momentum_resets_the_recursion_and_says_so() -> None:
    config = make_config(("base",), target=None, method="fused", momentum_sigma_nms=10.0)
    online = build_online(config, robot_model())
    for block in throw(0.1, 40):
        estimate = online.push(block)
        assert np.isfinite(estimate.mean).all()
        assert np.isfinite(estimate.covariance).all()
    assert not online.finish().valid
    assert "ESTIMATOR_RESET" in [code for _, code, _ in online.events()]


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("singular"), ZeroDivisionError()])
@pytest.mark.parametrize("unit", ["fold", "work", "settling"])
def test_any_failing_unit_of_the_recursion_is_a_reset(
    unit: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    online = build_online(make_config(), robot_model())
    blocks = noisy_blocks("target", 1, 4.0)
    for block in blocks[:-1]:
        online.push(block)

    def fails(*_: object) -> object:
        raise error

    assert isinstance(online, OnlineEstimator)
    monkeypatch.setattr(online.recursion, unit, fails)
    online.push(blocks[-1])
    final = online.finish()
    assert not final.valid
    assert "ESTIMATOR_RESET" in [code for _, code, _ in online.events()]


def test_a_failing_batch_is_an_error_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> object:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(batch_run, "minimise", fails)
    with pytest.raises(EstimatorError, match=r"arithmetic fails .*Singular matrix"):
        run_batch(make_config(), noisy_blocks("target", 1, 4.0), "fused", ())


def test_a_regression_that_meets_its_limit_is_not_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    config = make_config(method="mrnea", weighting="ols")
    blocks = noisy_blocks("target", 1, 12.0)
    assert run_batch(config, blocks, "mrnea", ())["status"] == "OK"
    monkeypatch.setattr(solver, "MAX_PLAIN_STEPS", 1)
    assert run_batch(config, blocks, "mrnea", ())["status"] == "NOT_CONVERGED"
