"""Short recordings of a held arm: errors stay within what sigma says, for any number of windows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, t

from fsw.estimators.batch.run import run_batch
from fsw.estimators.noise.few_windows import FEW_WINDOWS, few_windows, student
from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import robot_model
from tests.support.short_arm import recorded, short_arm_config

BEYOND_3, SURE = 2.7e-3, 0.999  # probability of an error beyond 3 sigma; of passing these tests
HARMLESS = {"INSUFFICIENT_EXCITATION"}


@pytest.mark.parametrize("dof", [4.0, 10.0, 24.0])
def test_three_sigma_of_the_widened_sigma_are_as_probable_as_of_a_gaussian(dof: float) -> None:
    rng = np.random.default_rng(1)
    variance = rng.chisquare(dof, 400_000) / dof
    z = rng.normal(size=len(variance)) / np.sqrt(variance * student(np.array(dof)))
    assert np.mean(np.abs(z) > 3.0) == pytest.approx(BEYOND_3, rel=0.15)
    assert student(np.array(dof)) == pytest.approx((t.ppf(0.99865, dof) / 3.0) ** 2, rel=1e-3)


def test_the_level_counts_what_the_parameters_have_fitted_and_is_never_below_the_declared() -> None:
    level, doubt = few_windows(np.full(8, 2.0), 56.0, 28)
    assert level == pytest.approx(2.0 * 8 / 6)
    assert doubt == pytest.approx(float(student(np.array(6.0))))
    assert few_windows(np.full(8, 0.2), 56.0, 28)[0] == 1.0
    assert few_windows(np.ones(2), 56.0, 28)[1] == pytest.approx(float(student(np.array(1.0))))


@pytest.mark.parametrize(
    ("windows", "loud_nm", "fades_s", "seeds"),
    [(5, 0.0, 1.0, 40), (5, 0.1, 1.0, 60), (14, 0.1, 0.1, 30)],
)
def test_errors_stay_within_the_stated_probability(
    windows: int, loud_nm: float, fades_s: float, seeds: int
) -> None:
    """Nothing declares the torque that fades; it is as large as a sample's noise."""
    config, z, nees, sigmas = short_arm_config(), [], [], []
    for seed in range(seeds):
        blocks, payload = recorded(config, seed, windows, loud_nm=loud_nm, fades_s=fades_s)
        found = run_batch(config, blocks, "fused", ())
        if not HARMLESS.issuperset(found["reasons"]):
            continue
        assert "windows show the noise" in found["note"]
        error = np.array(found["mean"])[:10] - payload
        P = np.array(found["covariance"])[:10, :10]
        z.append(error[0] / np.sqrt(P[0, 0]))
        nees.append(error @ np.linalg.solve(P, error))
        sigmas.append(np.sqrt(P[0, 0]))
    assert len(z) > 0.8 * seeds
    assert np.sum(np.abs(z) > 3.0) <= binom.ppf(SURE, len(z), BEYOND_3)
    assert np.sum(np.square(z)) < chi2.ppf(SURE, len(z))
    assert np.sum(np.array(nees) > chi2.ppf(0.9973, 10)) <= binom.ppf(SURE, len(z), BEYOND_3)
    assert np.median(sigmas) < 0.5 / np.sqrt(2.0)  # of use: the data halve the prior's variance


def test_from_the_settled_number_on_nothing_changes_and_below_it_sigma_is_wider() -> None:
    config = short_arm_config()
    blocks, _ = recorded(config, 3, FEW_WINDOWS, loud_nm=0.0, fades_s=1.0)
    many = run_batch(config, blocks, "fused", ())
    few = run_batch(config, blocks[:-1], "fused", ())
    assert "windows show the noise" not in many["note"]
    assert f"only {FEW_WINDOWS - 1} windows" in few["note"]
    ratio = few["sigma"]["target"]["mass_kg"] / many["sigma"]["target"]["mass_kg"]
    assert 1.0 < ratio < 1.35  # the arm's own doubt is the larger part


@pytest.mark.parametrize("windows", [4, 5, 12])
def test_batch_and_recursion_say_the_same(windows: int) -> None:
    config = short_arm_config()
    blocks, _ = recorded(config, 1, windows, loud_nm=0.1, fades_s=0.1)
    batch, online = run_batch(config, blocks, "fused", ()), build_online(config, robot_model())
    for block in blocks:
        online.push(block)
    found = online.finish()
    assert list(found.reasons) == batch["reasons"]
    assert ("TOO_FEW_BLOCKS" in found.reasons) == (windows < 5)
    k = list(found.names).index("target.m")
    sigma = np.sqrt(np.array(batch["covariance"])[k, k])
    assert np.sqrt(found.covariance[k, k]) == pytest.approx(sigma, rel=0.1)


def test_a_window_that_does_not_fit_is_left_out_of_few() -> None:
    config = short_arm_config()
    blocks, payload = recorded(config, 2, 8, loud_nm=0.0, fades_s=1.0)
    blocks[4] = replace(blocks[4], tau_nm=blocks[4].tau_nm + 5.0)
    found = run_batch(config, blocks, "fused", ())
    assert found["gated"] == 1
    sigma = found["sigma"]["target"]["mass_kg"]
    assert abs(found["estimate"]["target"]["mass_kg"] - payload[0]) < 3.0 * sigma < 0.6
