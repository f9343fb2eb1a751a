"""Torques that no model has, slower than a sensor's noise: honest where declared, else refused."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of, truth_of
from evidence.methods.flight_side import write_config
from evidence.methods.sensed import Channels, condition, declared
from evidence.mistakes.run import samples
from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.messages import Block

SEEDS = (0, 1, 2, 3)
SAMPLES = 4000  # 40 s of the motion
SIGMA_NM, FADES_S = 0.2, 0.3


def world(seed: int, folder: Path, sigma_nm: float) -> tuple[Config, tuple[Block, ...]]:
    """Return a configuration that declares so much, and blocks of a world that has SIGMA_NM."""
    right = write_config(scenario_of("target"), seed, folder)
    clean = samples("target", right, seed)
    rng, a = np.random.default_rng(2000 + seed), np.exp(-1.0 / (RATE_HZ * FADES_S))
    fresh = rng.standard_normal(clean.tau_nm.shape)
    fresh[1:] *= np.sqrt(1.0 - a * a)
    off = SIGMA_NM * lfilter([1.0], [1.0, -a], fresh, axis=0)
    moved = replace(clean, tau_nm=clean.tau_nm + off)
    begun = {field.name: getattr(moved, field.name)[:SAMPLES] for field in fields(moved)}
    config = declared(right, SENSOR_SETS["data sheet"], RATE_HZ, window_s=WINDOW_S, nodes=NODES)
    update = {"torque_model_sigma_nm": sigma_nm, "torque_model_correlation_s": FADES_S}
    joints = [joint.model_copy(update=update) for joint in config.joints]
    config = config.model_copy(update={"joints": joints})
    return config, tuple(condition(Channels(**begun), config, RATE_HZ))


def nees(found: dict) -> float:
    """Return the normalised error squared of the target."""
    error = np.array(found["mean"])[:10] - truth_of("target")
    P = np.array(found["covariance"])[:10, :10]
    return float(error @ np.linalg.solve(P, error))


@pytest.mark.parametrize("method", ["fused", "rda"])
def test_declared_torques_have_an_honest_covariance(method, tmp_path):
    total = 0.0
    for seed in SEEDS:
        config, blocks = world(seed, tmp_path, SIGMA_NM)
        found = run_batch(config, blocks, method, ())
        assert found["status"] == "OK"
        total += nees(found)
    assert chi2.ppf(0.0005, 10 * len(SEEDS)) < total < chi2.ppf(0.9995, 10 * len(SEEDS))


def test_undeclared_torques_are_refused_or_found_and_never_confidently_wrong(tmp_path):
    for seed in SEEDS[:2]:
        config, blocks = world(seed, tmp_path, 0.0)
        found = run_batch(config, blocks, "fused", ())
        assert found["status"] != "OK" or nees(found) < chi2.ppf(0.9999, 10)
