"""Sensors that do not fit the model somewhere in a recording: they are left out there.

In flight the recursion leaves such a channel out, block by block. A batch has all blocks at once.
If the batch fits, and every channel of every block is below half of the recursion's limit, nothing
is to be left out. The recursion, which takes longer than the batch, then need not run.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.errors import NUMERICAL
from fsw.estimators.batch.run import SETTLED, sound_blocks, with_noise_found
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import row_function, stack
from fsw.estimators.model.problem import Problem
from fsw.estimators.pipeline import Screening
from fsw.estimators.recursive.isolation import ChannelScreen
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block, FloatArray

SUSPECT = 0.5  # of the recursion's limit on the normalised innovation squared of a channel


def fits_throughout(
    config: Config,
    blocks: Sequence[Block],
    result: Mapping[str, Any],
    problem: Problem,
    x: FloatArray,
    covariance: FloatArray,
    fused: Collection[Rows],
) -> bool:
    """Return whether every channel of every block fits a batch result of these blocks.

    Parameters
    ----------
    result : result of `run_batch`; one that left blocks out, or is not valid, does not fit
    problem, x, covariance, fused : as given to `keep`: whole state (p,), (p, p), and rows there
    """
    if result["status"] not in SETTLED or result["gated"] or not fused:
        return False
    settings = config.estimator
    screen = ChannelScreen(problem.model.torque_sensors, config.health.false_alarm_probability)
    nothing, nodes = np.zeros(len(x)), settings.nodes
    try:
        root: FloatArray = np.asarray(np.linalg.cholesky(covariance), np.float64)
        if settings.method != "fused":
            seen = with_noise_found(problem, sound_blocks(blocks))[0]
            fused = stack(row_function(settings.method, settings.weighting, problem), seen, x)
        for rows in fused:
            if max(screen.ratios(rows, nodes, nothing, root, 1.0).values(), default=0.0) > SUSPECT:
                return False
    except NUMERICAL:
        return False
    return True


def lacks_more(blocks: Sequence[Block], others: Sequence[Block]) -> bool:
    """Return whether any of the blocks has other channels than its counterpart in `others`."""
    return any(_channels(a) != _channels(b) for a, b in zip(blocks, others, strict=True))


def _channels(block: Block) -> tuple[bytes, bool, bool, bool]:
    inertial = block.has_gyro, block.has_accelerometer, block.has_attitude
    return (block.has_joint.tobytes(), *inertial)


def screened(config: Config, blocks: Sequence[Block]) -> Iterator[Block]:
    """Yield the blocks without the channels that the recursion of a flight would leave out."""
    estimator = build_online(config)
    for block in blocks:
        try:
            estimator.push(block)
        except NUMERICAL:
            estimator.reset()
        yield estimator.screened(block) if isinstance(estimator, Screening) else block
