"""Residuals that are wider than their sigma are named; those of a correct model are not."""

import numpy as np
import pytest

from fsw.estimators.batch.run import run_batch
from offline.residuals import FALSE_ALARM, ChannelResiduals, channel_residuals
from tests.support.estimator_cases import make_config, noisy_blocks


def residuals(ratio: np.ndarray) -> ChannelResiduals:
    """Return residuals (N, c) with a sigma of one."""
    count, channels = ratio.shape
    return ChannelResiduals(
        names=tuple(map(str, range(channels))),
        units=("1",) * channels,
        t_ns=np.arange(count),
        value=ratio,
        sigma=np.ones_like(ratio),
    )


def test_noise_one_and_a_half_times_too_small_is_wide_and_a_missing_channel_is_not():
    rng = np.random.default_rng(1)
    ratio = rng.standard_normal((600, 3)) * [1.0, 1.5, 1.0]
    ratio[:, 2] = np.nan
    assert list(residuals(ratio).wide()) == ["1"]
    assert residuals(ratio).wide()["1"] == pytest.approx(1.5, rel=0.1)


@pytest.mark.parametrize("nodes", [20, 80, 600])
def test_white_residuals_are_called_wide_as_rarely_as_stated(nodes):
    """Bound: twice the stated rate in 40 000 channels, of which it expects at most four."""
    rng = np.random.default_rng(nodes)
    wide = sum(len(residuals(rng.standard_normal((nodes, 4000))).wide()) for _ in range(10))
    assert wide <= 2 * FALSE_ALARM * 40_000


@pytest.mark.parametrize("seed", range(3))
def test_no_channel_of_a_correct_batch_is_wide(seed):
    config, blocks = make_config(("target",)), noisy_blocks("target", seed, 24.0)
    states: list = []
    run_batch(config, blocks, "fused", ("target",), keep=lambda *own: states.append(own[:2]))
    problem, x = states[-1]
    assert channel_residuals(blocks, x, problem).wide() == {}
