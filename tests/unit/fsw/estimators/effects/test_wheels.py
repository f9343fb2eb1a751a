"""Wheels' conditioning: consistent at any rate, outliers left out, silence and nonsense refused."""

from typing import Any

import numpy as np
import pytest

from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.conditioning.window_fit import Instants
from fsw.estimators.effects.wheels import Turn, WheelMotion
from fsw.messages import ChannelWindow
from tests.support.wheel_cases import INERTIA_KG_M2, wheel_config

WINDOW_S, NODES = 0.4, 4


class Rotor:
    """Torque as a random walk on a fine grid, and samples of it."""

    def __init__(self, seed: int, walk: float, duration_s: float = 40.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.t_s = np.arange(0.0, duration_s, 1e-3)
        self.torque_nm = np.cumsum(walk * np.sqrt(1e-3) * self.rng.normal(size=len(self.t_s)))
        self.h_nms = 2.0 + np.cumsum(self.torque_nm) * 1e-3

    def at(self, t_s: np.ndarray) -> np.ndarray:
        h, torque = (np.interp(t_s, self.t_s, v) for v in (self.h_nms, self.torque_nm))
        return np.concatenate([h, torque])

    def window(self, k: int, config: Any, offset_nm: float = 0.0) -> ChannelWindow:
        period = 1.0 / config.rate_hz
        first, last = np.ceil(k * WINDOW_S / period), np.ceil((k + 1) * WINDOW_S / period)
        t_s = np.arange(first, last) * period
        h, torque = np.split(self.at(t_s), 2)
        speed = h / INERTIA_KG_M2 + config.speed_noise_rad_s * self.rng.normal(size=len(t_s))
        measured = np.full(len(t_s), np.nan)
        if config.torque == "measured":
            noise = config.torque_noise_nm * self.rng.normal(size=len(t_s))
            measured = torque + offset_nm + noise
        t_ns = np.rint(t_s * 1e9).astype(np.int64)
        values = np.column_stack([speed, measured])
        return ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)


def nodes_ns(k: int) -> np.ndarray:
    t_s = (k + 0.5) * WINDOW_S + 0.5 * WINDOW_S * gauss_nodes(NODES)
    return np.rint(t_s * 1e9).astype(np.int64)


def turn(wheel: WheelMotion, channel: ChannelWindow, k: int) -> Turn | None:
    return wheel.at(channel, round(k * WINDOW_S * 1e9), nodes_ns(k))


@pytest.mark.parametrize("rate_hz", [1.0, 3.0, 25.0, 500.0])
@pytest.mark.parametrize("torque", ["none", "measured"])
def test_errors_are_as_large_as_the_covariance_says(rate_hz: float, torque: str) -> None:
    config = wheel_config(
        rate_hz=rate_hz, torque=torque, torque_noise_nm=2e-3, torque_walk_nm_sqrt_s=0.05
    )
    nees = []
    for seed in range(8):
        rotor, wheel = Rotor(seed, 0.05), WheelMotion(config)
        offset = config.torque_offset_sigma_nm * np.random.default_rng(seed).normal()
        for k in range(60):
            found = turn(wheel, rotor.window(k, config, offset), k)
            if k < 20 or k % 10:
                continue  # windows far apart: those that share samples are not independent
            assert found is not None
            error = np.concatenate([found.h_nms, found.hd_nm])
            error -= rotor.at(nodes_ns(k) * 1e-9)
            nees.append(error @ np.linalg.solve(found.covariance, error) / (2 * NODES))
    assert np.mean(nees) == pytest.approx(1.0, abs=3.5 * np.sqrt(2.0 / (8 * len(nees))) + 0.05)


def test_a_measured_torque_helps_a_slow_wheel() -> None:
    sigma = {}
    for torque in ("none", "measured"):
        config = wheel_config(rate_hz=2.0, torque=torque, torque_noise_nm=2e-3)
        rotor, wheel = Rotor(1, 0.05), WheelMotion(config)
        for k in range(20):
            found = turn(wheel, rotor.window(k, config), k)
        assert found is not None
        sigma[torque] = np.sqrt(np.diag(found.covariance))
    assert (sigma["measured"] < sigma["none"]).all()


def test_an_outlier_is_left_out() -> None:
    config = wheel_config()
    clean, struck = (WheelMotion(config) for _ in range(2))
    channel = Rotor(1, 0.05).window(3, config)
    values = channel.values.copy()
    values[7, 0] += 50.0
    bad = ChannelWindow(t_ns=channel.t_ns, values=values, missing=False, stale=False)
    expected, found = turn(clean, channel, 3), turn(struck, bad, 3)
    assert found is not None
    assert expected is not None
    assert found.removed == 1
    bound = 3.0 * np.sqrt(np.diag(found.covariance)[:NODES])
    assert (np.abs(found.h_nms - expected.h_nms) < bound).all()


def test_samples_that_do_not_agree_make_no_momentum() -> None:
    config = wheel_config()
    channel = Rotor(1, 0.05).window(3, config)
    values = channel.values.copy()
    values[::2, 0] *= -1.0
    bad = ChannelWindow(t_ns=channel.t_ns, values=values, missing=False, stale=False)
    assert turn(WheelMotion(config), bad, 3) is None


def test_a_wheel_that_falls_silent_is_unknown_after_five_periods() -> None:
    config = wheel_config(rate_hz=5.0)
    rotor, wheel = Rotor(1, 0.05), WheelMotion(config)
    empty = ChannelWindow(
        t_ns=np.empty(0, np.int64), values=np.empty((0, 2)), missing=True, stale=False
    )
    assert turn(wheel, empty, 0) is None
    before = turn(wheel, rotor.window(1, config), 1)
    during = turn(wheel, empty, 2)
    assert before is not None
    assert during is not None
    assert during.covariance[0, 0] > 10.0 * before.covariance[0, 0]
    assert turn(wheel, empty, 4) is None
    assert turn(wheel, rotor.window(5, config), 5) is not None


def along(t_s: np.ndarray, speed_rad_s: np.ndarray) -> Turn | None:
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    values = np.column_stack([speed_rad_s, np.full(len(t_s), np.nan)])
    instants = Instants(t_ns.tobytes(), 0.5 * WINDOW_S, NODES, NODES - 1)
    channel = ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)
    return WheelMotion(wheel_config(rate_hz=500.0)).along(channel, instants)


def test_a_motor_that_is_switched_and_a_body_that_answers_cancel() -> None:
    """A body of inertia I turns with -h / I: what no polynomial follows is missing in both."""
    t_s, inertia = (np.arange(200) - 99.5) / 500.0, 3.0
    speed = np.where(t_s < 0.03, 20.0, 90.0)
    found = along(t_s, speed)
    assert found is not None
    fit = NodeFit(t_s, 0.5 * WINDOW_S, NODES - 1, NODES)
    rate = fit.coefficients(-INERTIA_KG_M2 * speed[:, None] / inertia)
    w, wd = (fit.operators((0, 1)) @ rate).reshape(2, -1)
    assert np.abs(inertia * w + found.h_nms).max() < 1e-9 * np.abs(found.h_nms).max()
    assert np.abs(inertia * wd + found.hd_nm).max() < 1e-9 * np.abs(found.hd_nm).max()
    np.testing.assert_allclose(
        found.covariance,
        fit.covariance((0, 1), INERTIA_KG_M2 * wheel_config().speed_noise_rad_s),
        rtol=1e-9,
    )


def test_few_samples_are_no_polynomial() -> None:
    t_s = np.linspace(-0.19, 0.19, 3 * NODES - 1)
    assert along(t_s, np.full(len(t_s), 5.0)) is None
