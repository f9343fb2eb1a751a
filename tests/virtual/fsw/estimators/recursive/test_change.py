"""Changes over whole motions: a step is found, louder noise is reported, old data are forgotten."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.estimator_cases import (
    TARGET,
    draw_biases,
    noisy,
    noisy_blocks,
    true_blocks_cached,
)
from tests.support.recursions import with_alarms
from tests.support.starts import STEP_AT, stepped

DELAY_BLOCKS = 5  # bound on the detection of a 5 % step of the target's mass


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_a_step_of_the_mass_is_found_and_the_estimate_follows(method: str) -> None:
    """5 %: found within 5 blocks; invalid at once; right again by the end, within 4 sigma."""
    rng = np.random.default_rng(4)
    biases = draw_biases(rng)
    blocks = [noisy(b, rng, biases) for b in stepped("target", 1.0, 1.05)]
    online, estimates, alarms = with_alarms(blocks, method=method)
    assert len(alarms) == 1
    assert STEP_AT <= alarms[0] < STEP_AT + DELAY_BLOCKS
    assert estimates[STEP_AT - 1].valid
    at = estimates[alarms[0]]
    assert (at.valid, at.reason) == (False, "REOPENED")
    body = online.finish().bodies["target"]
    assert abs(body.mass_kg - 1.05 * TARGET.mass_kg) < 4 * body.mass_sigma_kg
    assert body.mass_sigma_kg < 0.02 * TARGET.mass_kg


def test_noise_twice_the_declared_is_told_and_sigmas_follow() -> None:
    """All sensors at twice their noise: a noise ratio of 2, no change, sigmas twice as large."""
    rng = np.random.default_rng(6)
    biases = draw_biases(rng)
    blocks = []
    for k, b in enumerate(true_blocks_cached("target", 59.9)):
        names = ("cov_joint", "cov_tau", "cov_gyro", "cov_acc")
        louder = replace(b, index=k, **{name: 4.0 * getattr(b, name) for name in names})
        declared = {name: getattr(b, name) for name in names}
        blocks.append(replace(noisy(louder, rng, biases), **declared))
    online, _, alarms = with_alarms(blocks)
    assert not alarms
    last = online.finish()
    assert last.extra["noise_ratio"] == pytest.approx(2.0, abs=0.2)
    honest = with_alarms(noisy_blocks("target", 6))[0].finish()
    ratio = last.bodies["target"].mass_sigma_kg / honest.bodies["target"].mass_sigma_kg
    assert ratio == pytest.approx(2.0, rel=0.25)


def test_forgetting_without_end_changes_no_bit_and_a_finite_one_widens() -> None:
    blocks = noisy_blocks("target", 7, 30.0)
    never = with_alarms(blocks)[0].finish()
    endless = with_alarms(blocks, forgetting_time_s=1e30)[0].finish()
    assert np.array_equal(never.mean, endless.mean)
    assert np.array_equal(never.covariance, endless.covariance)
    short = with_alarms(blocks, forgetting_time_s=8.0)[0].finish()
    sigma = [e.bodies["target"].mass_sigma_kg for e in (never, short)]
    assert 1.2 * sigma[0] < sigma[1] < 10 * sigma[0]


def test_forgetting_is_the_same_in_retired_stored_and_running_information() -> None:
    """A store of 6 blocks and one of all: the same covariance within 5 % of each sigma."""
    blocks = noisy_blocks("target", 8, 30.0)
    few = with_alarms(blocks, forgetting_time_s=10.0, store_blocks=6)[0].finish()
    many = with_alarms(blocks, forgetting_time_s=10.0)[0].finish()
    ratio = np.sqrt(np.diag(few.covariance) / np.diag(many.covariance))
    assert np.all(np.abs(ratio - 1.0) < 0.05)
