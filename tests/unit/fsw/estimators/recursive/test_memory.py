"""The memory of the recursion: a pass over many blocks at once is a pass over one after another."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import row_function, usable_rows
from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive.memory import Memory, SafeRows
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import make_config, noisy_blocks, robot_model

MOST = 5  # of 18 blocks: no divisor


def passed(rows: SafeRows, blocks: Sequence[Block], points: Sequence[FloatArray], most: int):
    """Return the memory after a pass at the second point over blocks linearised at the first."""
    first, second = points
    prior = SquareRootInformation.from_prior(first, np.eye(len(first)))
    memory = Memory(prior, len(blocks))
    for block in blocks:
        (made,) = rows((block,), first, memory.gained, ())
        memory.add(block, made, first, keep=True)
    memory.begin(second)
    calls = 1
    while not memory.advance(rows, most):
        calls += 1
    return memory, calls


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda", "cm"])
@pytest.mark.parametrize("fails", [False, True])
def test_blocks_together_give_the_bits_of_one_after_the_other(method: str, fails: bool) -> None:
    """Also where a window has no gyro, and where one cannot be re-linearised at the new point."""
    unknown, options = ("target",), {"momentum_sigma_nms": 5.0}
    problem = build_problem(make_config(unknown, method=method, **options), robot_model())
    blocks = noisy_blocks("target", 1, 7.2)[:18]
    blocks[7] = replace(blocks[7], has_gyro=False)
    own = partial(usable_rows, row_function(method, "eiv", problem))
    first, second = problem.prior_mean, problem.prior_mean.copy()
    second[problem.body("target")] *= 1.1

    def rows(
        held: Sequence[Block], at: FloatArray, before: Impulse | None, fits: Sequence[bool]
    ) -> list[Rows]:
        spoilt = fails and at is not first and any(block.index == 11 for block in held)
        return [] if spoilt else own(held, at, before, fits)

    one, calls = passed(rows, blocks, (first, second), 1)
    many, fewer = passed(rows, blocks, (first, second), MOST)
    assert (calls, fewer) == (18, 4)
    assert one.failed == many.failed == int(fails)
    assert np.array_equal(one.data.R, many.data.R)
    assert np.array_equal(one.data.z, many.data.z)
