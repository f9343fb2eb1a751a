"""The estimates that the recursion publishes from the blocks of one seed, against the truth."""

from collections.abc import Mapping, Sequence
from typing import Any

from fsw.config import Config
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block, Estimate
from hil.judge.outcome import outputs, worst
from hil.judge.score import normalised_error_squared, stacked
from hil.world.inertia import FloatArray


def recursion_row(
    config: Config, blocks: Sequence[Block], truth: Mapping[str, FloatArray]
) -> tuple[dict[str, Any], Estimate]:
    """Return the row of a seed and the final estimate; `truth` has the report of each body."""
    online = build_online(
        config, RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    )
    published = [online.push(block) for block in blocks]
    final = online.finish()
    seen = outputs([*published, final], truth)
    x = stacked(truth, list(final.bodies))
    own = slice(0, x.size)
    row = {
        "valid": final.valid,
        "reason": final.reason,
        "nees": normalised_error_squared(final.mean[own] - x, final.covariance[own, own]),
        "dof": x.size,
        "z": worst(final.bodies, truth),
        "masses": {  # error and sigma [kg]
            name: [body.mass_kg - float(truth[name][0]), body.mass_sigma_kg]
            for name, body in final.bodies.items()
        },
        "outputs": seen["valid"],
        "wrong": seen["wrong"],
        "events": sorted({code for _, code, _ in online.events()}),
    }
    return row, final
