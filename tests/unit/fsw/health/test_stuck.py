"""Equal readings in a row: how many no live sensor gives, and what they take away."""

import math
from itertools import pairwise

import numpy as np
import pytest

from fsw.health.stuck import FALSE_ALARM, QUIETER, StuckScreen, equal_readings
from fsw.messages import JointSamples
from tests.support.estimator_cases import make_config
from tests.support.samples import imu_samples, joint_samples, rows


@pytest.mark.parametrize(("step", "sigma"), [(0.01, 0.05), (0.01, 0.2), (1e-4, 0.05)])
def test_the_count_bounds_the_chance_of_a_sensor_three_times_quieter(
    step: float, sigma: float
) -> None:
    """Against the exact probability: the sum over the cells of their power."""
    count = equal_readings(step, sigma)
    quiet = sigma / QUIETER
    edges = (np.arange(-2000, 2000) - 0.5) * step / quiet
    cdf = 0.5 * (1.0 + np.array([math.erf(x / math.sqrt(2.0)) for x in edges]))
    chance = float(np.sum(np.diff(cdf) ** count))
    assert chance < FALSE_ALARM
    assert count < 60


def test_a_sensor_quieter_than_its_step_is_never_stuck() -> None:
    assert equal_readings(0.01, 0.01) == 0


def joint(k: int, torque: float, period_ns: int = 2_000_000) -> JointSamples:
    return joint_samples((period_ns * k, period_ns * k, 2, 0.0, torque))


def test_a_stuck_torque_is_taken_out_and_comes_back_with_the_first_other_reading() -> None:
    config = make_config()
    limit = equal_readings(0.01, config.joints[2].torque_noise_nm)
    assert limit > 2
    tested = StuckScreen(config)
    torques = [1.0] * 60 + [1.01, 1.02]
    seen = [rows(tested.screen(joint(k, tau))) for k, tau in enumerate(torques)]
    kept = [sample.torque_nm is not None for (sample,) in seen]
    assert kept == [k < limit - 1 or k >= 60 for k in range(62)]
    (found, *_) = tested.take()
    assert (found.fault, found.subject) == ("TORQUE_STUCK", config.joints[2].name)
    assert found.t_ns == 2_000_000 * (limit - 1)


@pytest.mark.parametrize("period_ns", [1_000_000, 2_000_000, 20_000_000])
def test_what_stays_stuck_is_told_again_after_a_tenth_of_a_second(period_ns: int) -> None:
    tested = StuckScreen(make_config())
    for k in range(2_000_000_000 // period_ns):
        tested.screen(joint(k, 1.0, period_ns))
    told_ns = [found.t_ns for found in tested.take()]
    assert len(told_ns) > 10
    assert {b - a for a, b in pairwise(told_ns)} == {100_000_000}


def test_noise_rounded_to_the_wire_is_never_stuck() -> None:
    config = make_config()
    rng = np.random.default_rng(3)
    tested = StuckScreen(config)
    sigma = config.joints[2].torque_noise_nm / QUIETER
    torques = np.round(rng.normal(0.0, sigma, 100_000), 2).reshape(-1, 20)
    for k, batch in enumerate(torques.tolist()):
        times_ns = [2_000_000 * (20 * k + i) for i in range(20)]
        tested.screen(
            joint_samples(*((t, t, 2, 0.0, tau) for t, tau in zip(times_ns, batch, strict=True)))
        )
    assert tested.take() == []


def test_a_stuck_cluster_leaves_the_other() -> None:
    tested = StuckScreen(make_config())
    out = [
        sample
        for k in range(5)
        for sample in rows(
            tested.screen(imu_samples((k, k, k, (1e-3, 0.0, 0.0), (float(k), 0.0, 0.0))))
        )
    ]
    assert [s.w_NS_S_rad_s is None for s in out] == [False, False, True, True, True]
    assert all(s.f_NS_S_m_s2 is not None for s in out)
    assert {f.fault for f in tested.take()} == {"GYRO_STUCK"}
