"""Joints known by speed only, from the devices' bytes to the estimate."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.checks.configuration import validate
from fsw.estimators.batch.run import run_batch
from fsw.estimators.model import building
from fsw.exchange.checkpoint import Checkpoint, Identity, decode, encode
from fsw.exchange.restart import judge
from fsw.messages.commands import Command, CommandName
from hil.judge import judgement
from hil.run import bench
from hil.run.bench import T0_NS
from hil.world.links import body_of
from offline.describe import describe
from tests.support.estimator_cases import parameters
from tests.support.flown_daemon import Kept, bench_of, daemon_on, fly
from tests.support.short_cases import NoMeter, short

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
TURNING = (1, 3)


def judged(folder: Path, **overrides: Any) -> tuple[dict, bench.Recorded, bench.Setup]:
    scenario = short(folder, name="target_leo_speed", points=8)
    setup = bench.prepare(scenario, 1, folder, overrides=overrides)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded), recorded, setup


def nees(setup: bench.Setup, recorded: bench.Recorded) -> float:
    """NEES of the target by a batch over the blocks of a run."""
    kept: dict[str, Any] = {}

    def keep(problem: Any, mean: Any, covariance: Any, _: Any) -> None:
        kept.update(k=problem.body("target"), mean=mean, covariance=covariance)

    run_batch(setup.config, recorded.blocks, "fused", ["target"], keep=keep)
    truth = parameters(body_of(setup.scenario.truth["target"]))
    error = kept["mean"][kept["k"]] - truth
    return float(error @ np.linalg.solve(kept["covariance"][kept["k"], kept["k"]], error))


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> tuple[dict, bench.Recorded, bench.Setup]:
    return judged(tmp_path_factory.mktemp("speed"))


def test_the_target_is_found_though_two_joints_give_no_angle(flown):
    outcome, recorded, setup = flown
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    counters = recorded.status["samples"]["arm"]
    assert counters["lost"] == counters["late"] == counters["rejected"] == 0
    assert not [event for event in recorded.events if "ENCODER" in event.code]
    last = recorded.blocks[-4]  # within the motion
    truth = setup.history.at((last.t_ns - recorded.origin_ns) * 1e-9).q
    sigma = np.hypot(np.sqrt(last.walk_rad2), 2e-3)
    off = np.abs(last.q_rad - truth).max(axis=0)
    assert np.all(off[list(TURNING)] < 4.0 * sigma[list(TURNING)])
    assert off[list(TURNING)].max() > 1e-4  # it has walked
    assert np.delete(off, TURNING).max() < 1e-5


def test_without_the_states_of_the_walk_the_estimate_would_be_wrong(flown, monkeypatch):
    _, recorded, setup = flown
    assert nees(setup, recorded) < CHI2_10_999
    monkeypatch.setattr(building, "walks_of", lambda *_: None)
    assert nees(setup, recorded) > CHI2_10_999


def test_a_flight_longer_than_the_store_begins_new_epochs_of_the_walk(tmp_path):
    outcome, recorded, setup = judged(tmp_path, store_blocks=40)
    config = setup.config
    density = config.joints[TURNING[0]].speed_noise_rad_s ** 2 / config.buses[0].rate_hz
    reach_rad2 = density * 40 * config.estimator.window_s
    assert recorded.blocks[-1].walk_rad2[TURNING[0]] > 2.0 * reach_rad2
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999


def test_check_says_so(flown):
    config = flown[2].config
    words = " ".join(describe(config, validate(config)[0]).split())
    assert "joint2: speed only; its angle is integrated from" in words
    assert "walks of integrated angles in a minute" in words


def test_angles_go_on_over_a_changed_configuration_and_a_restart(tmp_path):
    """From the newest block on: joints are where the truth has them, not at their start."""
    setup = bench.prepare(short(tmp_path, name="target_leo_speed", points=8), 1, tmp_path)
    link, before, after = bench_of(setup), Kept(), Kept()
    daemon = daemon_on(setup, link, before)
    fly(daemon, link, 10.0)
    daemon.estimation.dispatcher.configure({"unknown": ["target"]})
    fly(daemon, link, 12.0)
    daemon.submit(Command(name=CommandName.SAVE_STATE))
    newest = replace(before.snapshots[-1], blocks=tuple(before.blocks))
    checkpoint = Checkpoint(identity=Identity(1, 2), sequence=1, boot_id="b", snapshot=newest)
    other = daemon_on(setup, link, after)
    data = encode(checkpoint)
    assert other.restart(judge(decode(data), "b", newest.t_ns, 60.0))
    fly(other, link, 16.0)
    for blocks in (before.blocks, after.blocks):
        last, (told,) = blocks[-1], {len(block.walk_rad2) for block in blocks}
        assert told == 7
        motion_s = (last.t_ns - T0_NS) * 1e-9 - 1.0  # rest before the motion
        off = np.abs(last.q_rad - setup.history.at(motion_s).q).max(axis=0)[list(TURNING)]
        assert np.all(off < 4.0 * np.hypot(np.sqrt(last.walk_rad2[list(TURNING)]), 2e-3) + 2e-3)
    start = np.array([setup.config.joints[k].start_rad for k in TURNING])
    assert np.abs(after.blocks[0].q_rad[0, list(TURNING)] - start).max() > 0.05
    assert not [event for event in after.events if "ENCODER" in event.code]
