"""One seed's results depend on the seed alone; noise-free samples return the truth."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from evidence.methods import sample_level
from evidence.methods.cases import (
    NODES,
    RATE_HZ,
    SENSOR_SETS,
    WIDER,
    WINDOW_S,
    Key,
    scenario_of,
    truth_of,
)
from evidence.methods.exact import exact_samples
from evidence.methods.fisher import bound, information
from evidence.methods.flight_side import problem_of, without_biases, write_config
from evidence.methods.methods import CONSISTENT, METHODS, MethodOutcome, on_blocks
from evidence.methods.sensed import condition, declared, sensed
from fsw.estimators.model.problem import Problem


def test_same_seed_gives_the_same_bits_whatever_else_is_run():
    alone = sample_level.run_seed("target", "data sheet", 5, ["fused"])
    among = sample_level.run_seed("target", "data sheet", 5, ["cm", "fused"])
    assert alone[0].error.tolist() == among[1].error.tolist()
    other = sample_level.run_seed("target", "data sheet", 6, ["fused"])
    assert alone[0].error.tolist() != other[0].error.tolist()


def test_fused_converges_from_the_wrong_prior_to_the_truth_without_noise(tmp_path):
    noise = SENSOR_SETS["data sheet"]
    plain = without_biases(scenario_of("target"))
    config = declared(
        write_config(plain, 1, tmp_path, WIDER), noise, RATE_HZ, window_s=WINDOW_S, nodes=NODES
    )
    blocks = condition(sensed(exact_samples("target"), config), config, RATE_HZ)
    outcome = on_blocks("fused", blocks, config)
    sigma = np.sqrt(np.diag(outcome.covariance))
    assert outcome.status == "OK"
    # a thousandth of a sigma per step is where the iteration stops; windows cut off less
    assert np.all(np.abs(outcome.x - truth_of("target")) < 0.05 * sigma)


def test_the_claimed_covariance_of_fused_is_the_bound_s():
    """One engine from raw samples: its sigma is that of the bench's own Fisher information.

    The motion is joined from window to window, so that the noise of the angles costs little.
    """
    (record,) = sample_level.run_seed("target", "data sheet", 5, ["fused"])
    exact = bound(information("target", "data sheet", "all", angles_exact=True))
    assert record.status == "OK"
    np.testing.assert_allclose(record.sigma, np.sqrt(np.diag(exact)), rtol=0.03)


def test_least_squares_of_the_flight_rows_is_a_plain_one(tmp_path):
    """Ten lines of numpy over Pinocchio's regressor, without the flight software's own rows."""
    import pinocchio as pin

    noise = SENSOR_SETS["data sheet"]
    plain = without_biases(scenario_of("target"))
    config = declared(write_config(plain, 1, tmp_path, WIDER), noise, RATE_HZ)
    blocks = condition(sensed(exact_samples("target"), config), config, RATE_HZ)[20:80]
    own = on_blocks("mrnea ols", blocks, config)
    problem: Problem = problem_of(config)
    model, p = problem.model.model, np.array(config.imu.mounting.p_BS_m)
    rows, right = [], []
    for block in blocks:
        for i in range(NODES):
            w, wd = block.w_NB_B_rad_s[i], block.wd_NB_B_rad_s2[i]
            a = block.f_NS_B_m_s2[i] - np.cross(wd, p) - np.cross(w, np.cross(w, p))
            q = np.concatenate([np.zeros(6), [1.0], block.q_rad[i]])
            v = np.concatenate([np.zeros(3), w, block.qd_rad_s[i]])
            full = np.concatenate([a, wd, block.qdd_rad_s2[i]])
            Y = pin.computeJointTorqueRegressor(model, problem.model.data, q, v, full)
            rows.append(Y @ problem.U)
            right.append(np.concatenate([np.zeros(6), block.tau_nm[i]]) - Y @ problem.pi_known)
    expected = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    np.testing.assert_allclose(own.x, expected, rtol=1e-5, atol=1e-4)


def test_errors_in_variables_know_a_base_by_its_mobility_where_the_imu_is_poor():
    """Seeds whose NEES in the parameters were 51 and 57; with a good IMU nothing is bent."""
    (record,) = sample_level.run_seed("base", "poor IMU", 48, ["mrnea eiv"])
    assert "larger to one side; sigma covers both" in record.bias_note
    assert record.nees < 35.0
    (record,) = sample_level.run_seed("base", "good IMU", 48, ["mrnea eiv"])
    assert record.bias_note == ""


def test_the_methods_whose_nees_is_judged_are_methods():
    assert set(CONSISTENT) <= set(METHODS)
    with pytest.raises(KeyError), tempfile.TemporaryDirectory() as folder:
        on_blocks("gravity", [], write_config(scenario_of("target"), 0, Path(folder)))


def test_result_that_is_not_finite_is_a_failure():
    key = Key(level="sample", case="base", sensors="data sheet", method="cm", seed=0)
    bad = MethodOutcome(status="OK", x=np.full(10, np.nan), covariance=np.eye(10), iterations=1)
    record = sample_level.judged(key, bad, np.zeros(10))
    assert record.error is None
    assert record.status.startswith("FAILED")
