"""The endurance run in short: bounded memory, finite factor, batch covariance."""

from dataclasses import replace

import numpy as np
import pytest

from evidence.speed.endurance import ESTIMATORS, Endurance, Look, endure, main, reachable_bytes
from hil.run.flown import Flown
from tests.support.estimator_cases import RATE_HZ, WINDOW_S, make_config, noisy_blocks, robot_model

BLOCKS = 450  # 90 000 joint sample sets of 500 Hz; half of them before the first look
UPDATES = BLOCKS * WINDOW_S * RATE_HZ


@pytest.mark.parametrize("name", ESTIMATORS)
def test_memory_is_flat_and_the_covariance_is_the_batchs(name: str) -> None:
    flown = Flown(
        config=make_config(("target",), store_blocks=16),
        model=robot_model(),
        blocks=noisy_blocks("target", 1, 30.0),
    )
    result = endure(name, flown, UPDATES)
    assert (result.blocks, result.updates) == (BLOCKS, UPDATES)
    assert result.passed, result.line()


LOOK = Look(updates=100_000, own_bytes=10_000, objects=5_000, resident_kb=200_000)


@pytest.mark.parametrize(
    ("leak", "flat"),
    [
        ({}, True),
        ({"own_bytes": 10_000 + 24 * 4500}, False),  # a float per block of 4500
        ({"objects": 5_000 + 4500}, False),
        ({"resident_kb": 200_000 + 4500 * 2}, False),  # an array of 250 floats per block
    ],
)
def test_what_is_kept_per_block_is_a_leak(leak: dict[str, int], flat: bool) -> None:
    result = Endurance(
        estimator="fused",
        blocks=5000,
        updates=1_000_000,
        looks=(LOOK, replace(LOOK, updates=1_000_000, **leak)),
        finite=True,
        covariance_difference=0.0,
    )
    assert result.flat is flat
    assert not replace(result, finite=False).passed
    assert not replace(result, covariance_difference=1e-5).passed


def test_reachable_bytes_sees_arrays_behind_views_closures_and_lists() -> None:
    whole = np.zeros(10_000)
    view = whole[:2]

    def closed() -> float:
        return float(view[0])

    assert reachable_bytes([closed]) > whole.nbytes
    assert reachable_bytes({"a": [np.zeros(5), np]}) < 1000


def test_an_unknown_estimator_is_refused() -> None:
    with pytest.raises(SystemExit) as refused:
        main(["kalman"])
    assert refused.value.code == 2
