"""A short form of `python -m hil.endurance`: bounded memory, finite factor, batch covariance."""

from __future__ import annotations

import pytest

from fsw.estimators.online import build_online
from hil.endurance import COVARIANCE_BOUND, endure
from tests.fsw.estimators.cases import WINDOW_S, make_config, noisy_blocks, robot_model

BLOCKS = 600  # 120 000 joint sample sets of 500 Hz


@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_memory_is_flat_and_the_covariance_is_the_batchs(method: str) -> None:
    config = make_config(("target",), method=method, store_blocks=16)
    online = build_online(config, robot_model())
    blocks = noisy_blocks("target", 1)
    result = endure(online, blocks, BLOCKS, round(WINDOW_S * 1e9), progress=False)
    assert result.finite
    assert result.covariance_difference < COVARIANCE_BOUND
    assert result.passed
