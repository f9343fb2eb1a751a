"""Rows of one block."""

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.energy import stacked_energy_rows
from fsw.estimators.measurement.fused import CHANNELS, stacked_fused_rows
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows, stacked_mrnea_rows
from fsw.estimators.measurement.prediction import Rate
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray


def energy_rows(block: Block, x: FloatArray, problem: Problem) -> Rows:
    """Return `stacked_energy_rows` of one block."""
    return stacked_energy_rows(BlockStack((block,)), x, problem)[0]


def mrnea_rows(block: Block, x: FloatArray, problem: Problem, weighting: str) -> Rows:
    """Return `stacked_mrnea_rows` of one block."""
    return stacked_mrnea_rows(BlockStack((block,)), x, problem, weighting)[0]


def fused_rows(
    block: Block,
    x: FloatArray,
    problem: Problem,
    channels: tuple[str, ...] = CHANNELS,
    rate: Rate = "momentum",
    before: Impulse | None = None,
) -> Rows:
    """Return `stacked_fused_rows` of one block."""
    return stacked_fused_rows(BlockStack((block,)), x, problem, channels, rate, before)[0]
