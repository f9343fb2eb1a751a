"""What the study's methods get: right without noise, as noisy as it says with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence.methods.sensed import ChannelNoise
from evidence.paper.cases import ALL, NOISES, PAPER, PaperUnit, noise_of, scenario_of
from evidence.paper.identify import config_of
from evidence.paper.samples import Conditioned, conditioned, history_of

RATE_HZ = 100.0
UNIT = PaperUnit(level="sample", orbit="leo", system="target", noise=PAPER, acting=ALL, seed=1)
QUIET = ChannelNoise(
    position_rad=0.0, torque_nm=0.0, rate_rad_s=0.0, acceleration_m_s2=0.0, attitude_rad=0.0
)


def blocks_of(noise: ChannelNoise, seed: int, folder: Path) -> Conditioned:
    config = config_of(UNIT, folder, with_wrench=False)
    return conditioned("leo", "target", ALL, noise, RATE_HZ, seed, config)


def stacked(data: Conditioned, name: str) -> np.ndarray:
    return np.concatenate([getattr(block, name) for block in data.blocks])


def test_without_noise_the_blocks_are_the_truth(tmp_path: Path) -> None:
    """The spline holds the planned motion; windows of 0.4 s cut off less than a node's noise."""
    data = blocks_of(QUIET, 1, tmp_path)
    truth = history_of("leo", "target", ALL).at(stacked(data, "t_ns") * 1e-9)
    assert np.abs(stacked(data, "q_rad") - truth.q).max() < 1e-7
    assert np.abs(stacked(data, "qdd_rad_s2") - truth.qdd).max() < 3e-6  # off the plan by wrenches
    assert np.abs(stacked(data, "tau_nm") - truth.tau).max() < 5e-4
    assert np.abs(stacked(data, "w_NB_B_rad_s") - truth.w_NB_B).max() < 1e-6
    assert np.abs(stacked(data, "wd_NB_B_rad_s2") - truth.wd_NB_B).max() < 2e-5


def test_the_claimed_noise_is_the_noise(tmp_path: Path) -> None:
    """Torque, rate, acceleration at the nodes: 600 x 3 values and more, 5 % is 3 sigma."""
    data = blocks_of(noise_of(PAPER, RATE_HZ), 23000, tmp_path)
    clean = blocks_of(QUIET, 23000, tmp_path)
    block = data.blocks[0]
    claimed = {
        "tau_nm": block.cov_tau[0],
        "w_NB_B_rad_s": block.cov_gyro[:4, :4],
        "wd_NB_B_rad_s2": block.cov_gyro[4:, 4:],
        "f_NS_B_m_s2": block.cov_acc,
    }
    for name, covariance in claimed.items():
        drawn = (stacked(data, name) - stacked(clean, name)).std()
        assert drawn == pytest.approx(np.sqrt(np.mean(np.diag(covariance))), rel=0.06), name
    curve = data.curve
    drawn = (curve.coefficients - clean.curve.coefficients) / np.sqrt(np.diag(curve.covariance))[
        :, None
    ]
    assert drawn.std() == pytest.approx(1.0, rel=0.25)


def test_readings_and_orbits() -> None:
    assert noise_of(PAPER, 100.0).torque_nm == pytest.approx(3.16e-3, rel=1e-3)
    assert noise_of("literal", 100.0).torque_nm == pytest.approx(0.316, rel=1e-3)
    assert noise_of("averaged", 100.0).torque_nm == pytest.approx(0.0316, rel=1e-3)
    assert noise_of("one sequence", 100.0).shared
    assert len(NOISES) == 6
    geo = scenario_of("geo", "both", ALL)
    assert geo.unknown == ("base", "target")
    assert geo.environment is not None
    assert geo.environment.atmosphere is None
    assert scenario_of("leo", "base", "none").environment is None
    alone = scenario_of("leo", "base", "sunlight").environment
    assert alone is not None
    assert alone.solar_pressure is not None
    assert not alone.gravity_gradient


def test_one_sequence_is_on_every_channel(tmp_path: Path) -> None:
    shared = replace(noise_of(PAPER, RATE_HZ), shared=True)
    data, clean = blocks_of(shared, 2, tmp_path), blocks_of(QUIET, 2, tmp_path)
    torque = stacked(data, "tau_nm") - stacked(clean, "tau_nm")
    assert np.allclose(torque[:, 0], torque[:, 6])
