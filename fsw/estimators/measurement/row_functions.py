"""The methods as row functions: what recursive and batch solutions share."""

from __future__ import annotations

from typing import Protocol

from fsw.estimators.measurement.energy import energy_rows
from fsw.estimators.measurement.fused import Rate, fused_rows
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows, mrnea_rows
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from fsw.messages.errors import EstimatorError


class RowsFunction(Protocol):
    """Whitened rows of one block at a state, given the momentum gained before it."""

    def __call__(self, block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        """Return A and b with A delta = b, and the momentum gained after the block."""
        ...


def row_function(method: str, weighting: str, problem: Problem) -> RowsFunction:
    """Return the rows of a method: mrnea, rda, cm, ce or fused.

    A block without accelerometer or gyro leaves MRNEA's base rows without their measurement: its
    torques are then used as RDA's, with the rate that the momentum gives where the gyro is missing.
    So are the other torques of a block in which one is missing.

    Raises
    ------
    EstimatorError for an unknown method.
    """

    def mrnea(block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        if block.has_gyro and block.has_accelerometer and block.has_joint.all():
            return mrnea_rows(block, x, problem, weighting)
        return rda(block, x, before)

    def rda(block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        rate: Rate = "measured" if block.has_gyro else "momentum"
        return fused_rows(block, x, problem, ("torque",), rate, before)

    def momentum(block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        return fused_rows(block, x, problem, ("gyro",), "momentum", before)

    def energy(block: Block, x: FloatArray, _before: Impulse | None = None, /) -> Rows:
        return energy_rows(block, x, problem)

    def fused(block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        return fused_rows(block, x, problem, before=before)

    functions: dict[str, RowsFunction] = {
        "mrnea": mrnea,
        "rda": rda,
        "cm": momentum,
        "ce": energy,
        "fused": fused,
    }
    if method not in functions:
        raise EstimatorError(f"method {method!r} is not one of {', '.join(functions)}")
    return functions[method]
