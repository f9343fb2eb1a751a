"""A model that does not fit is not believed again because a few blocks fit anything."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.change import colour
from fsw.estimators.recursive.online import build_online
from fsw.estimators.recursive.trust import LASTING_BLOCKS, SUSPECT_BLOCKS, Trust
from hil.world.truth import Body
from tests.support.estimator_cases import (
    BASE,
    TARGET,
    make_config,
    noisy_blocks,
    robot_model,
)

WHITE = [np.random.default_rng(k).normal(size=52) for k in range(120)]
ALIKE = [row + 0.5 * np.random.default_rng(999).normal(size=52) for row in WHITE]


def test_colour_tells_residuals_that_are_alike_from_white_ones() -> None:
    found, limit = colour(WHITE)
    assert abs(found) < 0.7 * limit
    found, limit = colour(ALIKE)
    assert found > 2.0 * limit
    assert colour([]) == (0.0, 1.0)
    assert colour([np.ones(3), np.ones(4)]) == (0.0, 1.0)


def test_a_mismatch_that_lasts_before_a_reopening_costs_trust() -> None:
    trust = Trust()
    trust.learn(ALIKE, 1.0)
    assert trust.mismatch(1.0)
    for _ in range(LASTING_BLOCKS):
        trust.note(1.0)
    assert not trust.successor(100, 1).suspect  # a change of bodies looks like this
    trust.note(1.0)
    after = trust.successor(100, 1)
    assert after.is_doubtful(SUSPECT_BLOCKS - 1)
    assert not after.is_doubtful(SUSPECT_BLOCKS)


def test_many_blocks_left_out_are_a_model_that_does_not_fit() -> None:
    trust = Trust()
    for _ in range(9):
        trust.leave_out()
    assert not trust.is_scattered(6, least=25), "too few to judge"
    assert not trust.is_scattered(27, least=25), "a quarter may be outliers"
    assert trust.is_scattered(26, least=25)
    again = Trust()
    again.restore(trust.snapshot())
    assert again.is_scattered(26, least=25)
    assert not trust.successor(100, 1).is_scattered(26, least=25)


def test_a_second_reopening_soon_after_the_first_costs_trust() -> None:
    assert not Trust().successor(10, 1).suspect
    assert Trust().successor(SUSPECT_BLOCKS - 1, 2).suspect
    assert not Trust().successor(SUSPECT_BLOCKS, 2).suspect


def test_a_known_base_one_percent_heavy_is_never_valid_and_wrong() -> None:
    """Declared as exact: it was valid and wrong, re-opened, valid and wrong, four times."""
    heavy = Body(1.01 * BASE.mass_kg, BASE.com_m, tuple(1.01 * x for x in BASE.inertia_kg_m2))
    online = build_online(make_config(base=heavy, settle_blocks=25), robot_model())
    wrong = []
    for block in noisy_blocks("target", 3, 59.9):
        estimate = online.push(block)
        body = estimate.bodies["target"]
        if estimate.valid and abs(body.mass_kg - TARGET.mass_kg) > 5.0 * body.mass_sigma_kg:
            wrong.append(block.index)
    assert not wrong
    assert not online.finish().valid


@pytest.mark.parametrize("kind", ["target", "base"])
def test_right_models_stay_valid(kind: str) -> None:
    config = make_config((kind,), target=TARGET if kind == "target" else None)
    online = build_online(config, robot_model())
    for block in noisy_blocks(kind, 7, 40.0):
        online.push(block)
        found, limit = online.recursion.trust.colour
        assert found < 0.9 * limit
    assert online.finish().valid


def test_no_verdict_contradicts_valid() -> None:
    blocks = [replace(b, q_rad=b.q_rad + 0.12) for b in noisy_blocks("target", 2, 20.0)]
    online = build_online(make_config(), robot_model())
    for block in blocks:
        online.push(block)
    report = online.report()
    assert not report["valid"]
    assert report["verdict"]["target"] == (
        f"target mass not identified: the estimate is not valid, {', '.join(report['reasons'])}"
    )
