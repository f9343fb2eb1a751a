"""How many windows a configuration asks for before an estimate may be valid."""

from typing import Any

import pytest

from fsw.config import Config
from fsw.config.processing import LEAST_WINDOWS
from tests.support.short_arm import short_arm_config


def asked(**changes: Any) -> int:
    return short_arm_config(**changes).estimator.settle_blocks


def test_a_held_arm_that_exists_in_recordings_only_needs_few_windows() -> None:
    assert asked() == LEAST_WINDOWS
    assert asked(estimator={"settle_blocks": None}) == LEAST_WINDOWS
    config = short_arm_config()
    assert Config.model_validate(config.model_dump()) == config


@pytest.mark.parametrize(
    "changes",
    [
        {"buses": [{"name": "arm", "interface": "virtual", "channel": "a", "rate_hz": 500.0}]},
        {"estimator": {"settle_blocks": 25}},
    ],
)
def test_every_other_robot_needs_as_many_as_before(changes: dict[str, Any]) -> None:
    assert asked(**changes) == 25


def test_the_operator_decides() -> None:
    assert asked(estimator={"settle_blocks": 2}) == 2
