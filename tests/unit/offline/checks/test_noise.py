"""Noise of recorded channels, found without a model of the motion; windows too long for it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fsw.messages import ChannelWindow, Window
from offline.checks.noise import difference_sigma, noise_findings
from tests.support.estimator_cases import make_config

RATE_HZ, WINDOW_S, SIGMA_RAD, SIGMA_NM = 250.0, 0.4, 1e-6, 0.05


def motion(t: np.ndarray, hz: float) -> np.ndarray:
    return 0.5 * np.sin(2.0 * np.pi * hz * t)


def windows_of(q: np.ndarray, tau: np.ndarray, t_ns: np.ndarray, joints: int) -> list[Window]:
    size = round(RATE_HZ * WINDOW_S)
    empty = ChannelWindow(
        t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), missing=True, stale=True
    )
    made = []
    for k in range(len(t_ns) // size):
        own = slice(k * size, (k + 1) * size)
        values = np.column_stack([q[own], tau[own]])
        channel = ChannelWindow(t_ns=t_ns[own], values=values, missing=False, stale=False)
        start_ns = round(k * WINDOW_S * 1e9)
        made.append(
            Window(
                index=k,
                start_ns=start_ns,
                stop_ns=start_ns + round(WINDOW_S * 1e9),
                joints=(channel,) * joints,
                gyro=empty,
                accelerometer=empty,
                attitude=empty,
            )
        )
    return made


def findings(
    q: np.ndarray,
    tau: np.ndarray,
    t_ns: np.ndarray,
    declared_rad: float = SIGMA_RAD,
    model_nm: float = 0.0,
):
    config = make_config()
    declared = {
        "position_noise_rad": declared_rad,
        "torque_noise_nm": SIGMA_NM,
        "torque_model_sigma_nm": model_nm,
    }
    joints = tuple(joint.model_copy(update=declared) for joint in config.joints)
    buses = tuple(bus.model_copy(update={"rate_hz": RATE_HZ}) for bus in config.buses)
    estimator = config.estimator.model_copy(update={"window_s": WINDOW_S, "nodes": 4})
    config = config.model_copy(update={"joints": joints, "buses": buses, "estimator": estimator})
    found = noise_findings(config, windows_of(q, tau, t_ns, len(joints)))
    return {own.key: own for own in found}


def grid(rng: np.random.Generator, jitter: float = 0.0, seconds: float = 20.0) -> np.ndarray:
    t = np.arange(seconds * RATE_HZ) / RATE_HZ
    return np.rint((t + jitter * rng.uniform(-1, 1, len(t)) / RATE_HZ) * 1e9).astype(np.int64)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("hz", [0.0, 0.5, 3.0])
def test_differences_show_the_noise_whatever_the_motion(hz: float, jitter: float) -> None:
    rng = np.random.default_rng(5)
    t_ns = grid(rng, jitter)
    noise = rng.normal(0.0, 1e-4, len(t_ns))
    noise[100::97] += 0.1  # spikes
    assert difference_sigma((t_ns, motion(t_ns * 1e-9, hz) + noise)) == pytest.approx(1e-4, rel=0.1)


def test_the_misfit_of_a_window_is_not_taken_for_noise_and_a_shorter_window_is_named() -> None:
    rng = np.random.default_rng(6)
    t_ns = grid(rng)
    q = motion(t_ns * 1e-9, 3.0) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    found = findings(q, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns)
    noise, window = found["joints.0.position_noise_rad"], found["estimator.window_s"]
    assert noise.found == pytest.approx(SIGMA_RAD, rel=0.2)
    assert not noise.wrong
    assert "window too long for this motion" in window.wrong
    assert window.found in (0.2, 0.1)
    slow = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    assert "estimator.window_s" not in findings(slow, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns)


def test_a_misfit_within_the_declared_noise_needs_no_shorter_window() -> None:
    rng = np.random.default_rng(6)
    t_ns = grid(rng)
    q = motion(t_ns * 1e-9, 3.0) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    found = findings(q, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns, declared_rad=0.02)
    assert "estimator.window_s" not in found


@pytest.mark.parametrize("correlation_s", [0.005, 0.02])
def test_coloured_noise_is_noise_and_no_misfit(correlation_s: float) -> None:
    rng = np.random.default_rng(7)
    t_ns = grid(rng, seconds=60.0)
    fading, tau = np.exp(-1.0 / (RATE_HZ * correlation_s)), np.zeros(len(t_ns))
    white = rng.normal(0.0, SIGMA_NM * np.sqrt(1.0 - fading**2), len(t_ns))
    for k in range(1, len(tau)):
        tau[k] = fading * tau[k - 1] + white[k]
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    found = findings(q, tau, t_ns)
    assert "estimator.window_s" not in found
    assert found["joints.0.torque_noise_nm"].found == pytest.approx(SIGMA_NM, rel=0.3)


def fading_torque(rng: np.random.Generator, count: int, correlation_s: float) -> np.ndarray:
    """Return a torque of unit variance that no model explains, at RATE_HZ."""
    fading = np.exp(-1.0 / (RATE_HZ * correlation_s))
    fresh = rng.normal(0.0, np.sqrt(1.0 - fading**2), count + 500)
    return np.asarray(lfilter([1.0], [1.0, -fading], fresh)[500:])


@pytest.mark.parametrize("correlation_s", [0.01, 0.03, 0.1])
def test_a_torque_that_is_declared_to_be_outside_of_the_model_is_no_noise_too_small(
    correlation_s: float,
) -> None:
    rng = np.random.default_rng(11)
    t_ns = grid(rng, seconds=30.0)
    model = 3.0 * SIGMA_NM * fading_torque(rng, len(t_ns), correlation_s)
    tau = model + rng.normal(0.0, SIGMA_NM, len(t_ns))
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    found = findings(q, tau, t_ns, model_nm=3.0 * SIGMA_NM)
    assert not [own.text() for key, own in found.items() if own.wrong and "joints" in key]
    # four times that: none of it is white, so the estimate finds and counts it; the note says so
    louder = findings(q, 4.0 * model + tau, t_ns, model_nm=3.0 * SIGMA_NM)
    own = louder["joints.0.torque_model_sigma_nm"]
    assert "sigma counts" in own.note
    assert own.adopted
    assert 0.25 < own.found / (15.0 * SIGMA_NM) < 1.1  # a window's polynomial takes slow parts
    assert not [own.text() for key, own in louder.items() if own.wrong and "joints" in key]


def test_white_noise_beyond_that_of_sensor_and_model_is_wrong() -> None:
    rng = np.random.default_rng(12)
    t_ns = grid(rng, seconds=30.0)
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    tau = rng.normal(0.0, 4.0 * SIGMA_NM, len(t_ns))
    own = findings(q, tau, t_ns, model_nm=2.0 * SIGMA_NM)["joints.0.torque_noise_nm"]
    assert "the data are noisier" in own.wrong
    assert own.found == pytest.approx(4.0 * SIGMA_NM, rel=0.1)
    quiet = findings(q, tau / 4.0, t_ns, model_nm=2.0 * SIGMA_NM)["joints.0.torque_noise_nm"]
    assert (quiet.wrong, quiet.note) == ("", "")  # less than the sum is no cleaner sensor


@pytest.mark.parametrize(("ratio", "is_wrong"), [(1.0, False), (1.6, True), (1.0 / 1.6, False)])
def test_noise_that_is_declared_too_small_does_not_fit(ratio: float, is_wrong: bool) -> None:
    rng = np.random.default_rng(8)
    t_ns = grid(rng)
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, ratio * SIGMA_RAD, len(t_ns))
    found = findings(q, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns)["joints.0.position_noise_rad"]
    assert bool(found.wrong) == is_wrong


def test_noise_in_motion_counts_not_that_at_rest() -> None:
    rng = np.random.default_rng(9)
    t_ns = grid(rng)
    moves = t_ns > t_ns[-1] // 2
    q = np.where(moves, motion(t_ns * 1e-9, 0.3), 0.0)
    q = q + rng.normal(0.0, np.where(moves, 3.0, 1.0) * SIGMA_RAD, len(t_ns))
    found = findings(q, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns)["joints.0.position_noise_rad"]
    assert found.found == pytest.approx(3.0 * SIGMA_RAD, rel=0.2)


@pytest.mark.parametrize(("sway_rad", "is_wrong"), [(0.0, False), (5e-5, False), (0.3, True)])
def test_a_joint_at_rest_is_no_wrong_unit(sway_rad: float, is_wrong: bool) -> None:
    """Its encoder is a hundred times quieter than in motion; held joints sway with the others."""
    rng = np.random.default_rng(13)
    t_ns = grid(rng)
    q = sway_rad * np.sin(3.0 * t_ns * 1e-9) + rng.normal(0.0, 0.01 * SIGMA_RAD, len(t_ns))
    own = findings(q, rng.normal(0.0, SIGMA_NM, len(t_ns)), t_ns)["joints.0.position_noise_rad"]
    assert bool(own.wrong) == is_wrong
    assert ("hardly moves" in own.note) != is_wrong


def test_a_filtered_torque_is_no_wrong_unit() -> None:
    rng = np.random.default_rng(14)
    t_ns = grid(rng)
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    own = findings(q, 20.0 * np.cos(q) + 1e-9, t_ns)["joints.0.torque_noise_nm"]
    assert not own.wrong
    assert "filtered torques" in own.note


def test_a_time_that_comes_twice_is_used_once() -> None:
    rng = np.random.default_rng(10)
    t_ns = grid(rng)
    q = motion(t_ns * 1e-9, 0.2) + rng.normal(0.0, SIGMA_RAD, len(t_ns))
    tau = rng.normal(0.0, SIGMA_NM, len(t_ns))
    t_ns[101::100] = t_ns[100::100]
    found = findings(q, tau, t_ns)
    assert not found["joints.0.position_noise_rad"].wrong
    assert found["joints.0.torque_noise_nm"].found == pytest.approx(SIGMA_NM, rel=0.1)
