"""Data that no body explains must not be published as valid."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import N, make_config, noisy_blocks, robot_model


@pytest.mark.parametrize("joint", [1, 3])
def test_a_wrong_zero_of_a_joint_is_not_a_valid_estimate(joint: int) -> None:
    """A zero 0.12 rad off: the fit settles on some body, and its residuals say it is none."""
    shift = np.zeros(N)
    shift[joint] = 0.12
    online = build_online(make_config(), robot_model())
    for block in noisy_blocks("target", 2, 30.0):
        online.push(replace(block, q_rad=block.q_rad + shift))
    final = online.finish()
    assert not final.valid
    assert final.reason in ("MODEL_MISMATCH", "NOT_CONVERGED")
