"""A torque sensor that goes wrong: what jobs get of it, and a replay of the run."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from evidence.fault_matrix import run, table
from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.batch.screening import screened
from fsw.messages import Block
from hil.judge.score import normalised_error_squared
from hil.run import bench
from hil.run.bench import Setup
from hil.run.collector import Collector
from hil.run.progress import Quiet
from hil.world.inertia import pi_of
from offline import identify as identification
from offline.replay import replay

pytestmark = pytest.mark.timeout(600)
BOUNDS = table.load()
JOINT = 2  # node 0x13


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setup, bench.Recorded]:
    """A run whose third torque sensor reads half too much for a second, recorded."""
    folder = tmp_path_factory.mktemp("isolation")
    setup = run.prepare(BOUNDS, 1, folder)
    (row,) = [row for row in BOUNDS.faults if row.type == "torque_scale"]
    scenario = dataclasses.replace(setup.scenario, faults=(BOUNDS.entry(row),))
    setup = dataclasses.replace(setup, scenario=scenario)
    return setup, bench.run_virtual(setup, Quiet(), record=True)


def test_batch_jobs_get_no_torque_that_was_found_not_to_fit(
    story: tuple[Setup, bench.Recorded],
) -> None:
    setup, recorded = story
    at_ns = bench.T0_NS + round(BOUNDS.at_s * 1e9)
    wrong = [
        block
        for block in recorded.blocks
        if at_ns <= block.t_ns[0] and block.t_ns[-1] < at_ns + round(BOUNDS.for_s * 1e9)
    ]
    assert wrong
    assert not any(block.has_joint[JOINT] for block in wrong)
    others = np.arange(7) != JOINT
    assert all(block.has_joint[others].all() for block in recorded.blocks)
    result = run_batch(setup.config, recorded.blocks, "fused", ("target",))
    truth = pi_of(setup.scenario.truth["target"])
    mean, covariance = np.array(result["mean"]), np.array(result["covariance"])
    nees = normalised_error_squared(mean[:10] - truth, covariance[:10, :10])
    assert nees < chi2.ppf(BOUNDS.probability, 10)


def test_a_replay_isolates_the_same_and_ends_in_the_same_estimate(
    story: tuple[Setup, bench.Recorded],
) -> None:
    setup, recorded = story
    again = Collector()
    result = replay(Path(setup.folder) / "recording.mcap", setup.config, sink=again)
    assert result.estimate is not None
    live = recorded.estimates[-1]
    assert np.array_equal(result.estimate.mean, live.mean)
    assert np.array_equal(result.estimate.covariance, live.covariance)
    assert len(again.blocks) == len(recorded.blocks)
    for one, other in zip(again.blocks, recorded.blocks, strict=True):
        assert np.array_equal(one.has_joint, other.has_joint)
    found = result.status["health"]["incidents"]
    assert found == recorded.status["health"]["incidents"]
    assert found["TORQUE_INCONSISTENT"] == 1


def test_a_batch_without_a_recursion_leaves_out_the_same(
    story: tuple[Setup, bench.Recorded], monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = story[0]
    path = Path(setup.folder) / "recording.mcap"
    screenings: list[int] = []

    def watched(config: Config, blocks: Sequence[Block]) -> list[Block]:
        screenings.append(len(blocks))
        return screened(config, blocks)

    monkeypatch.setattr(identification, "screened", watched)
    alone = identification.identify(path, setup.config, "fused", ())
    assert len(screenings) == 1
    beside = identification.identify(path, setup.config, "fused", (), show=lambda *_: None)
    assert len(screenings) == 1
    del alone["wall_s"], beside["wall_s"]
    assert alone == beside
