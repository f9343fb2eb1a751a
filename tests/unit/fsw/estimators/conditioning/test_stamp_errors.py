"""An error of a sample's time counts as one of its position, by the speed of the window."""

import numpy as np
import pytest

from fsw.config.signals import TimingConfig
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.messages import ChannelWindow, Window
from tests.support.estimator_cases import RATE_HZ, WINDOW_S, N, make_config, robot_model

SIGMA_S, LIMIT_RAD_S, RUNS = 2e-5, 2.0, 300
NONE = ChannelWindow(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), missing=True, stale=True)


def window(speed_rad_s: float, rng: np.random.Generator, noise_rad: float) -> Window:
    """Return a window of joints that move evenly, whose stamps are wrong by white errors."""
    count = round(WINDOW_S * RATE_HZ)
    t_s = 10.0 + (np.arange(count) + 0.3) / RATE_HZ
    channels = []
    for _ in range(N):
        q = speed_rad_s * (t_s + SIGMA_S * rng.standard_normal(count))
        q = q + noise_rad * rng.standard_normal(count)
        values = np.column_stack([q, rng.standard_normal(count)])
        t_ns = np.rint(t_s * 1e9).astype(np.int64)
        channels.append(ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False))
    return Window(
        index=0,
        start_ns=10 * 10**9,
        stop_ns=round((10.0 + WINDOW_S) * 1e9),
        joints=tuple(channels),
        gyro=NONE,
        accelerometer=NONE,
        attitude=NONE,
    )


@pytest.mark.parametrize("ratio", [0.05, 0.3, 1.0])
def test_the_covariance_is_that_of_the_speed_of_the_window(ratio: float) -> None:
    """Mean squared whitened error of rates and accelerations: 1, within 5 sigma of its scatter."""
    rng = np.random.default_rng(4)
    config = make_config()
    timing = TimingConfig(by="arrival", sigma_s=SIGMA_S)
    joints = tuple(joint.model_copy(update={"timing": timing}) for joint in config.joints)
    config = config.model_copy(update={"joints": joints})
    conditioner = build_conditioner(config, robot_model())
    noise_rad, speed = config.joints[0].position_noise_rad, ratio * LIMIT_RAD_S
    squares: list[float] = []
    for _ in range(RUNS):
        block = conditioner.blocks([window(speed, rng, noise_rad)])[0]
        assert block is not None
        size = len(block.qd_rad_s)
        for k in range(N):
            for own, error in enumerate((block.qd_rad_s[:, k] - speed, block.qdd_rad_s2[:, k])):
                at = slice(own * size, (own + 1) * size)
                P = block.cov_joint[k][at, at]
                squares.append(float(error @ np.linalg.solve(P, error)) / size)
    scatter = np.sqrt(2.0 / (RUNS * N * size))
    assert abs(np.mean(squares) - 1.0) < 5.0 * scatter + 0.01
