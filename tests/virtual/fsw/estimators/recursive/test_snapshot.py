"""A state taken out, written, read and put back continues exactly where it was."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.errors import EstimatorError
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.exchange.checkpoint import Checkpoint, Identity, decode, encode
from fsw.messages import Block, Estimate, Snapshot
from tests.support.estimator_cases import make_config, noisy_blocks, robot_model
from tests.unit.fsw.estimators.test_external_moments import orbit

IDENTITY = Identity(1, 2)
COUNT = 44
METHODS: dict[str, dict[str, Any]] = {
    "fused": {"method": "fused"},
    "fused small store": {"method": "fused", "store_blocks": 16},
    "fused forgetting": {"method": "fused", "forgetting_time_s": 10.0},
    "mrnea eiv": {"method": "mrnea"},
    "mrnea ols": {"method": "mrnea", "weighting": "ols"},
    "rda": {"method": "rda"},
    "cm": {"method": "cm"},
}


def blocks() -> list[Block]:
    """Return noisy blocks with two bad ones: a gap in the numbers, and one that is gated."""
    data = noisy_blocks("target", 3, 30.0)[:COUNT]
    data[35] = replace(data[35], tau_nm=data[35].tau_nm + 50.0)
    return [replace(block, index=block.index + 7 * (k > 25)) for k, block in enumerate(data)]


def through_a_file(estimator: OnlineEstimator) -> Snapshot:
    """Return the estimator's state as it comes back from a checkpoint's bytes."""
    snapshot = Snapshot(t_ns=5, grid_ns=7, state=estimator.snapshot(), blocks=estimator.blocks)
    written = Checkpoint(identity=IDENTITY, sequence=1, boot_id="b", snapshot=snapshot)
    return decode(encode(written), IDENTITY).snapshot


def restored(estimator: OnlineEstimator, make: Any) -> OnlineEstimator:
    snapshot = through_a_file(estimator)
    fresh = make()
    fresh.restore(snapshot.state, {block.index: block for block in snapshot.blocks})
    return fresh


def assert_same(a: Estimate, b: Estimate) -> None:
    """To the last bit: the same rows come from the same blocks at the same points."""
    assert np.array_equal(a.mean, b.mean)
    assert np.array_equal(a.covariance, b.covariance)
    assert (a.valid, a.reason, a.blocks, a.gated) == (b.valid, b.reason, b.blocks, b.gated)
    assert a.extra == b.extra


@pytest.mark.parametrize(("method", "units"), [*((m, 0) for m in METHODS), ("fused", 5)])
def test_a_run_with_a_restore_in_the_middle_is_the_run_without(method: str, units: int) -> None:
    """Restored after every tenth block, in the middle of a pass or not."""

    def make() -> OnlineEstimator:
        return build_online(make_config(settle_blocks=20, **METHODS[method]), robot_model())

    through, broken = make(), make()
    for k, block in enumerate(blocks()):
        whole, parted = through.push(block), broken.push(block)
        assert_same(whole, parted)
        for estimator in (through, broken):
            for _ in range(units):
                estimator.work()
        if k % 10 == 9:
            broken = restored(broken, make)
    assert_same(through.finish(), broken.finish())
    assert through.report() == broken.report()


def test_the_momentum_gained_from_gravity_survives() -> None:
    config = make_config(settle_blocks=20)
    problem = replace(build_problem(config, robot_model()), orbit=orbit())

    def make() -> OnlineEstimator:
        rows = row_function("fused", "eiv", problem)
        return OnlineEstimator(problem, config.estimator, rows, linear=False)

    through, broken = make(), make()
    for k, block in enumerate(blocks()):
        assert_same(through.push(block), broken.push(block))
        if k % 10 == 9:
            broken = restored(broken, make)


def test_a_snapshot_does_not_change_with_the_estimator() -> None:
    """What was taken stays what it was, however long the estimator goes on."""
    data = blocks()
    online = build_online(make_config(settle_blocks=20), robot_model())
    for block in data[:20]:
        online.push(block)
    taken = Snapshot(t_ns=5, grid_ns=7, state=online.snapshot(), blocks=online.blocks)
    before = encode(Checkpoint(identity=IDENTITY, sequence=1, boot_id="b", snapshot=taken))
    for block in data[20:]:
        online.push(block)
    online.finish()
    after = encode(Checkpoint(identity=IDENTITY, sequence=1, boot_id="b", snapshot=taken))
    assert before == after


@pytest.mark.parametrize(
    ("other", "missing"),
    [
        (make_config(("base", "target")), False),
        (make_config(), True),
    ],
    ids=["other unknowns", "block missing"],
)
def test_a_state_that_does_not_fit_changes_nothing(other: Any, missing: bool) -> None:
    online = build_online(make_config(), robot_model())
    for block in blocks()[:20]:
        online.push(block)
    target = build_online(other, robot_model())
    before = target.estimate(0)
    stored = {block.index: block for block in online.blocks[missing:]}
    state = online.snapshot()
    state["recursion"]["noise"]["windows"] += 1
    with pytest.raises(EstimatorError):
        target.restore(state, stored)
    assert_same(before, target.estimate(0))
    assert not target.snapshot()["recursion"]["noise"]["windows"].any()
