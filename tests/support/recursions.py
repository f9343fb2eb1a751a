"""The recursion over blocks, and what it reported on the way."""

from typing import Any

from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block, Estimate
from tests.support.estimator_cases import make_config, robot_model


def with_alarms(
    blocks: list[Block], **options: Any
) -> tuple[OnlineEstimator, list[Estimate], list[int]]:
    """Return the estimator of a target, its estimates, and the blocks where a change was found."""
    online = build_online(make_config(("target",), **options), robot_model())
    estimates, alarms = [], []
    for block in blocks:
        estimates.append(online.push(block))
        if any(code == "CHANGE_DETECTED" for _, code, _ in online.events()):
            alarms.append(block.index)
    return online, estimates, alarms


def to_the_end(
    blocks: list[Block], **options: Any
) -> tuple[OnlineEstimator, list[Estimate], list[str]]:
    """Return the estimator of a target, its estimates with the settled one, and all its events."""
    online = build_online(make_config(("target",), **options), robot_model())
    estimates = [online.push(block) for block in blocks]
    estimates.append(online.finish())
    return online, estimates, [code for _, code, _ in online.events()]
