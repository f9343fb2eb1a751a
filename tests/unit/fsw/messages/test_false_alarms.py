"""The budget of false alarms: the shares are within it, and thresholds have their rates."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from fsw.config.health import HealthConfig
from fsw.config.processing import EstimatorConfig
from fsw.drivers.sources.sync_pace import STEADY, STEPS
from fsw.estimators import reasons
from fsw.estimators.conditioning.window_fit import GATE_SIGMAS
from fsw.estimators.noise import creep
from fsw.estimators.recursive import change, prior_groups
from fsw.messages import false_alarms


def test_the_shares_of_all_checks_are_within_the_budget() -> None:
    assert sum(false_alarms.SHARES.values()) <= false_alarms.FLIGHT_RATE
    assert set(false_alarms.TESTS) <= set(false_alarms.SHARES | false_alarms.DELAYS)
    assert not set(false_alarms.DELAYS) & set(false_alarms.SHARES)


def test_each_threshold_over_all_its_tests_has_its_share() -> None:
    """By the distributions of scipy.stats."""
    rate, blocks = false_alarms.rate, false_alarms.BLOCKS
    normal, half = stats.norm.sf, 0.5 * stats.chi2.sf(reasons.INCONSISTENT, 1)
    for check, chance, tests in (
        ("gate", EstimatorConfig().gate_probability, blocks),
        ("sensor", HealthConfig().false_alarm_probability, blocks * false_alarms.SENSORS),
        ("slow", change.SLOW_PROBABILITY, blocks),
        ("colour", normal(change.COLOURED_SIGMAS), blocks),
        ("prior", prior_groups.GROUP_PROBABILITY, false_alarms.PRIOR_TESTS),
        ("consistency", half, blocks),
        ("sample", 2.0 * normal(GATE_SIGMAS), false_alarms.SAMPLES),
        ("change", change.CHANGE_RATE, blocks),
        ("pace", 2.0 * stats.t.sf(STEADY, STEPS - 1), false_alarms.PACES),
        ("drift", 2.0 * normal(creep.REFUSED), false_alarms.CHANGES),
        ("creep", 2.0 * normal(creep.NOTICED), false_alarms.CHANGES),
    ):
        assert chance * tests == pytest.approx(rate(check), rel=1e-6), check


@pytest.mark.parametrize(("count", "dof"), [(4, 52), (64, 24)])
def test_a_noise_level_stands_out_no_more_often_than_stated(count: int, dof: int) -> None:
    """Medians of chi-square means: their normal value at the stated tail is within the limit's."""
    rng = np.random.default_rng(0)
    medians = np.median(rng.chisquare(dof, (200_000, count)) / dof, axis=1)
    alike = count * dof / change.MEDIAN_LOSS
    chance = 1e-4
    limit = stats.chi2.isf(chance, alike) / alike
    assert np.mean(medians > limit) <= chance + 4.0 * np.sqrt(chance / len(medians))


def test_the_page_states_the_share_of_every_check() -> None:
    page = (Path(__file__).parents[4] / "docs" / "false_alarms.md").read_text()
    stated = dict(re.findall(r"^\| `(\w+)` \| (\S+) \|", page, re.MULTILINE))
    every = false_alarms.SHARES | false_alarms.DELAYS
    assert {check: float(share) for check, share in stated.items()} == every
