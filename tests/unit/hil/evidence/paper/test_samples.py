"""What the study's methods get: right without noise, as noisy as it says with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.evidence.paper.cases import ALL, NOISES, PAPER, ChannelNoise, noise_of, scenario_of
from hil.evidence.paper.samples import channels_of, noisy_samples

RATE_HZ = 100.0
QUIET = ChannelNoise(
    position_rad=0.0, torque_nm=0.0, rate_rad_s=0.0, acceleration_m_s2=0.0, attitude_rad=0.0
)


def test_without_noise_the_samples_are_the_truth():
    """The spline holds the planned motion; windows of 0.4 s cut off less than a node's noise."""
    samples = noisy_samples("leo", "target", ALL, QUIET, RATE_HZ, 1)
    truth = channels_of("leo", "target", ALL, RATE_HZ).nodes
    assert np.abs(samples.q - truth.q).max() < 1e-7
    assert np.abs(samples.qdd - truth.qdd).max() < 3e-6  # disturbances move it off the plan
    assert np.abs(samples.tau - truth.tau).max() < 5e-4
    assert np.abs(samples.w_NB_B - truth.w_NB_B).max() < 1e-6
    assert np.abs(samples.wd_NB_B - truth.wd_NB_B).max() < 2e-5


def test_the_claimed_noise_is_the_noise():
    """Torque, rate, acceleration at the nodes: 600 x 3 values and more, 5 % is 3 sigma."""
    noise = noise_of(PAPER, RATE_HZ)
    samples = noisy_samples("leo", "target", ALL, noise, RATE_HZ, 23000)
    clean = noisy_samples("leo", "target", ALL, QUIET, RATE_HZ, 23000)
    for name, claimed in (("tau", "tau_nm"), ("w_NB_B", "w_rad_s"), ("a_NB_B", "a_m_s2")):
        drawn = (getattr(samples, name) - getattr(clean, name)).std()
        assert drawn == pytest.approx(getattr(samples.noise, claimed)[0], rel=0.06)
    slope = (samples.wd_NB_B - clean.wd_NB_B).std()
    assert slope == pytest.approx(samples.noise.wd_rad_s2[0], rel=0.06)
    # of the spline's acceleration the noise is stated larger, as it lasts for an interval
    curve = (samples.qdd - clean.qdd).std()
    assert 2 * curve < samples.noise.qdd_rad_s2[0] < 10 * curve


def test_readings_and_orbits():
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


def test_one_sequence_is_on_every_channel():
    shared = replace(noise_of(PAPER, RATE_HZ), shared=True)
    samples = noisy_samples("leo", "target", ALL, shared, RATE_HZ, 2)
    clean = noisy_samples("leo", "target", ALL, QUIET, RATE_HZ, 2)
    torque, rate = samples.tau - clean.tau, samples.w_NB_B - clean.w_NB_B
    assert np.allclose(torque[:, 0], torque[:, 6])
    assert np.allclose(torque[:, 0], rate[:, 2])
