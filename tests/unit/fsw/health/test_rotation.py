"""Gyro against star tracker, on rotations known in closed form: a spin about one axis of B."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.health.rotation import MEDIAN_OF, RotationMonitor, without_spikes
from fsw.messages import ChannelWindow, Window
from fsw.messages.findings import Fault
from tests.support.driver_configs import star_tracker_config
from tests.support.estimator_cases import make_config

WINDOW_NS = 400_000_000
SPIN_RAD_S = 0.05
NOISE_RAD = 5e-5
Change = Callable[[float], float]


def config() -> Config:
    return make_config().model_copy(
        update={"star_tracker": star_tracker_config(rate_hz=5.0, noise_about_rad=NOISE_RAD)}
    )


def nothing(_t_s: float) -> float:
    return 0.0


def window(
    index: int, rng: np.random.Generator, gyro: Change = nothing, turn: Change = nothing
) -> Window:
    """Spin about z; `gyro` adds to the measured rate, `turn` to the tracker's angle."""
    start = index * WINDOW_NS
    t = start + np.arange(0, WINDOW_NS, 2_000_000)
    rate = np.zeros((len(t), 3))
    rate[:, 2] = SPIN_RAD_S + np.array([gyro(x * 1e-9) for x in t])
    rate += 1e-3 * rng.normal(size=rate.shape)
    at = start + np.array([50_000_000, 250_000_000])
    angle = SPIN_RAD_S * at * 1e-9 + np.array([turn(x * 1e-9) for x in at])
    angle = angle + NOISE_RAD * rng.normal(size=2)
    q = np.stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)], axis=1)

    def channel(t_ns: np.ndarray, values: np.ndarray) -> ChannelWindow:
        return ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)

    empty = channel(t[:0], rate[:0])
    return Window(
        index=index, start_ns=start, stop_ns=start + WINDOW_NS, joints=(),
        gyro=channel(t, rate), accelerometer=empty, attitude=channel(at, q),
    )  # fmt: skip


def run(
    count: int, gyro: Change = nothing, turn: Change = nothing, seed: int = 0
) -> list[tuple[Window, set[str]]]:
    tested, rng = RotationMonitor(config()), np.random.default_rng(seed)
    out = []
    for k in range(count):
        judged, found = tested.judge(window(k, rng, gyro, turn))
        out.append((judged, {f.fault for f in found}))
    return out


@pytest.mark.parametrize("seed", range(10))
def test_sensors_that_agree_raise_nothing(seed: int) -> None:
    for judged, found in run(100, seed=seed):
        assert not found
        assert not judged.gyro.missing
        assert len(judged.attitude.t_ns) == 2


def test_half_a_turn_of_the_tracker_is_left_out_while_it_lasts() -> None:
    out = run(20, turn=lambda t: np.pi if 2.0 <= t < 4.0 else 0.0)
    for k, (judged, found) in enumerate(out):
        flipped = 5 <= k < 10
        assert found == ({Fault.TRACKER_FLIP} if flipped else set())
        assert judged.attitude.missing is flipped
        assert not judged.gyro.missing


def test_a_jump_is_another_fault_than_half_a_turn() -> None:
    out = run(10, turn=lambda t: 0.4 if 2.0 <= t < 2.8 else 0.0)
    assert [found for _, found in out[5:7]] == [{Fault.TRACKER_JUMP}] * 2
    assert not any(found for k, (_, found) in enumerate(out) if k not in (5, 6))


def test_one_wrong_solution_is_the_tracker_s() -> None:
    out = run(10, turn=lambda t: 0.01 if abs(t - 2.05) < 0.01 else 0.0)
    assert [len(judged.attitude.t_ns) for judged, _ in out] == [2, 2, 2, 2, 2, 1, 2, 2, 2, 2]
    assert Fault.GYRO_INCONSISTENT not in set().union(*(found for _, found in out))


def test_a_gyro_that_turns_otherwise_pair_after_pair_is_left_out_and_comes_back() -> None:
    out = run(20, gyro=lambda t: 0.02 if 2.0 <= t < 4.0 else 0.0)
    missing = [judged.gyro.missing for judged, _ in out]
    assert not any(missing[:5])
    assert all(missing[6:10])
    assert not any(missing[12:])
    found = set().union(*(found for _, found in out))
    assert found == {Fault.GYRO_INCONSISTENT}


def across(k: int, rng: np.random.Generator, gyro_x_rad_s: float = 0.0) -> Window:
    """Spin about z as `window`, with a rate about x added to the gyro's."""
    made = window(k, rng)
    rate = made.gyro.values + np.array([gyro_x_rad_s, 0.0, 0.0])
    return replace(made, gyro=replace(made.gyro, values=rate))


def test_a_tracker_read_the_wrong_way_is_named_and_the_gyro_is_kept() -> None:
    """The inverse of every attitude turns by the same angles about other axes."""
    tested, rng = RotationMonitor(config()), np.random.default_rng(3)
    mounted = np.array([0.5, 0.5, 0.5, 0.5])
    texts = set()
    for k in range(20):
        made = window(k, rng)
        there = Rotation.from_quat(made.attitude.values) * Rotation.from_quat(mounted)
        wrong = (there.inv() * Rotation.from_quat(mounted).inv()).as_quat()
        judged, found = tested.judge(replace(made, attitude=replace(made.attitude, values=wrong)))
        assert not judged.gyro.missing or k < 4
        assert k < 4 or not any(one.fault is Fault.GYRO_INCONSISTENT for one in found)
        texts |= {one.text for one in found}
    assert any("rotation or a mounting is wrong" in text for text in texts)


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_a_gyro_that_errs_about_another_axis_is_still_the_gyro_s(share: float) -> None:
    tested, rng = RotationMonitor(config()), np.random.default_rng(4)
    for k in range(10):
        added = share * SPIN_RAD_S if k >= 5 else 0.0
        judged, found = tested.judge(across(k, rng, added))
        assert all(one.fault is Fault.GYRO_INCONSISTENT for one in found)
        assert k == 5 or judged.gyro.missing == (k > 5)


def test_a_tracker_that_was_away_is_judged_by_the_gyro_alone() -> None:
    tested, rng = RotationMonitor(config()), np.random.default_rng(0)
    for k in range(60):
        w = window(k, rng)
        if 10 <= k < 50:
            away = ChannelWindow(
                t_ns=w.attitude.t_ns[:0], values=w.attitude.values[:0], missing=True, stale=True
            )
            w = Window(
                index=k, start_ns=w.start_ns, stop_ns=w.stop_ns, joints=(), gyro=w.gyro,
                accelerometer=w.accelerometer, attitude=away,
            )  # fmt: skip
        judged, found = tested.judge(w)
        assert not found
        assert judged.attitude.missing is (10 <= k < 50)


@pytest.mark.parametrize("seed", range(5))
def test_single_wrong_rates_are_not_integrated(seed: int) -> None:
    struck = set(np.random.default_rng(seed).choice(1900, size=40, replace=False).tolist())
    out = run(10, gyro=lambda t: 0.5 if round(t / 0.002) in struck else 0.0, seed=seed)
    assert not set().union(*(found for _, found in out))


@pytest.mark.parametrize("count", [5, 6, 7, 50])
def test_a_spike_is_replaced_by_numpy_s_median(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(50):
        values = np.round(rng.normal(size=(count, 3)), 1)
        values[rng.random((count, 3)) < 0.1] *= 50.0
        values[rng.random(count) < 0.1] = np.nan
        padded = np.pad(values, ((2, 2), (0, 0)), mode="reflect")
        near = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_OF, axis=0)
        middle = np.median(near, axis=-1)
        expected = np.where(np.abs(values - middle) > 1.0, middle, values)
        np.testing.assert_array_equal(without_spikes(values, 1.0), expected)
