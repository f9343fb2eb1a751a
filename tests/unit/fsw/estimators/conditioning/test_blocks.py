"""From samples to nodes: values, derivatives, covariances, outliers, missing channels."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fsw.config.thrusters import ThrusterConfig
from fsw.estimators.conditioning.arm_motion import held_samples
from fsw.estimators.conditioning.blocks import Conditioner, build_conditioner
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.messages import Block, ChannelWindow, Window
from hil.world.history import rotation_matrices
from tests.support.estimator_cases import (
    NO_ATTITUDE,
    NODES,
    POSITION_NOISE_RAD,
    TORQUE_NOISE_NM,
    WINDOW_S,
    N,
    channel,
    make_config,
    motion,
    robot_model,
    sampled_window,
    true_block,
)
from tests.support.thruster_cases import thruster_settings

START_S = 20.0


def conditioner() -> Conditioner:
    return Conditioner(make_config(), tuple(range(N)))


def condition(window: Window) -> Block:
    block = conditioner().condition(window)
    assert block is not None
    return block


def window(seed: int = 0) -> Window:
    return sampled_window(motion("target"), np.random.default_rng(seed), START_S)


def without(old: ChannelWindow, drop: list[int]) -> ChannelWindow:
    keep = np.setdiff1d(np.arange(len(old.t_ns)), drop)
    return replace(old, t_ns=old.t_ns[keep], values=old.values[keep])


def spiked(old: ChannelWindow, at: list[int], size: float, column: int) -> ChannelWindow:
    values = old.values.copy()
    values[at, column] += size
    return replace(old, values=values)


def with_joint(old: Window, joint: int, new: ChannelWindow) -> Window:
    return replace(old, joints=(*old.joints[:joint], new, *old.joints[joint + 1 :]))


def assert_equal(a: Block, b: Block, rtol: float = 1e-12) -> None:
    """Bound: rounding of 1 rad, 1e-16, through the operator of a second derivative, 1e4 / s^2."""
    for field in fields(Block):
        left, right = np.asarray(getattr(a, field.name)), np.asarray(getattr(b, field.name))
        np.testing.assert_allclose(left, right, rtol=rtol, atol=2e-12, err_msg=field.name)


def test_errors_at_the_nodes_have_the_stated_covariance() -> None:
    """Chi-square of every channel over 150 windows of one true motion, 99.99 % band."""
    history = motion("target")
    rng = np.random.default_rng(1)
    sums: dict[str, float] = {}
    dofs: dict[str, int] = {}

    def add(name: str, error: np.ndarray, covariance: np.ndarray) -> None:
        values, vectors = np.linalg.eigh(covariance)
        # 3 m values of m + 3 coefficients: the rest of the directions is exact
        keep = values > 1e-10 * values[-1]
        white = (vectors[:, keep] / np.sqrt(values[keep])).T @ error
        sums[name] = sums.get(name, 0.0) + float(white @ white)
        dofs[name] = dofs.get(name, 0) + len(white)

    for k in range(150):
        start = 0.5 + 0.37 * k
        block = condition(sampled_window(history, rng, start))
        true = true_block(history, start)
        for j in range(N):
            tau = block.tau_nm[:, j] - true.tau_nm[:, j]
            speed = block.qd_rad_s[:, j] - true.qd_rad_s[:, j]
            acceleration = block.qdd_rad_s2[:, j] - true.qdd_rad_s2[:, j]
            add("tau", tau, block.cov_tau[j])
            position = block.q_rad[:, j] - true.q_rad[:, j]
            add("joint", np.concatenate([speed, acceleration, position]), block.cov_joint[j])
        for axis in range(3):
            w = block.w_NB_B_rad_s[:, axis] - true.w_NB_B_rad_s[:, axis]
            wd = block.wd_NB_B_rad_s2[:, axis] - true.wd_NB_B_rad_s2[:, axis]
            f = block.f_NS_B_m_s2[:, axis] - true.f_NS_B_m_s2[:, axis]
            add("acc", f, block.cov_acc)
            add("gyro", np.concatenate([w, wd]), block.cov_gyro)
    for name, total in sums.items():
        low, high = chi2.ppf([5e-5, 1 - 5e-5], dofs[name])
        assert low < total < high, (name, total / dofs[name])


def test_positions_at_the_nodes_are_those_of_the_motion() -> None:
    true = true_block(motion("target"), START_S)
    block = condition(window())
    assert np.array_equal(block.t_ns, true.t_ns)
    assert np.abs(block.q_rad - true.q_rad).max() < 1e-6


def test_sensor_axes_are_turned_to_the_base() -> None:
    config = make_config()
    half = 0.5**0.5
    mounting = config.imu.mounting.model_copy(update={"q_BS_xyzw": (0.0, 0.0, half, half)})
    turned = config.model_copy(update={"imu": config.imu.model_copy(update={"mounting": mounting})})
    block = Conditioner(turned, tuple(range(N))).condition(window())
    plain = condition(window())
    assert block is not None
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for name in ("w_NB_B_rad_s", "wd_NB_B_rad_s2", "f_NS_B_m_s2"):
        np.testing.assert_allclose(getattr(block, name), getattr(plain, name) @ R.T, atol=1e-14)


def test_joints_are_put_in_the_order_of_the_model() -> None:
    config = make_config()
    shuffled = config.model_copy(update={"joints": config.joints[::-1]})
    w = window()
    built = build_conditioner(shuffled, robot_model())
    block = built.condition(replace(w, joints=w.joints[::-1]))
    assert block is not None
    assert_equal(block, condition(w))


@pytest.mark.parametrize("channel_name", ["torque", "position", "gyro", "accelerometer"])
def test_spikes_are_counted_and_leave_the_result_of_a_window_lacking_them(
    channel_name: str,
) -> None:
    at = [17, 90, 160]
    w = window()
    if channel_name in ("torque", "position"):
        size, column = (15.0, 1) if channel_name == "torque" else (1e-3, 0)
        bad = with_joint(w, 2, spiked(w.joints[2], at, size, column))
        if channel_name == "torque":  # the positions of those samples are as good as any
            good = with_joint(w, 2, spiked(w.joints[2], at, math.nan, 1))
        else:
            good = with_joint(w, 2, without(w.joints[2], at))
    else:
        old = getattr(w, channel_name)
        bad = replace(w, **{channel_name: spiked(old, at, 2.0, 1)})
        good = replace(w, **{channel_name: without(old, at)})
    tested = conditioner()
    block = tested.condition(bad)
    assert block is not None
    assert tested.outliers == len(at)
    code = {"gyro": "GYRO_SPIKE", "accelerometer": "ACC_SPIKE", "torque": "TORQUE_SPIKE"}
    (found,) = tested.findings()
    assert found.fault == code.get(channel_name, "ENCODER_SPIKE")
    expected = condition(good)
    if channel_name == "position":  # the reference lacks three torques too
        expected = replace(
            expected,
            tau_nm=block.tau_nm,
            cov_tau=block.cov_tau,
            tau_products_nm2=block.tau_products_nm2,
        )
    # a window with spikes does not tell of the noise
    assert_equal(block, replace(expected, imu_products=block.imu_products))


def plain(channel: ChannelWindow, column: int, degree: int, order: int) -> tuple[np.ndarray, ...]:
    """Return a channel's derivative at the nodes and its operator, by textbook least squares."""
    nodes = legendre.leggauss(NODES)[0]
    s = (channel.t_ns * 1e-9 - START_S - WINDOW_S / 2) / (WINDOW_S / 2)
    basis = legendre.legvander(s, degree)
    unit = np.eye(degree + 1)
    at = np.stack([legendre.legval(nodes, legendre.legder(e, order)) for e in unit], axis=1)
    operator = at @ np.linalg.pinv(basis) / (WINDOW_S / 2) ** order
    return operator @ channel.values[:, column], operator


def test_joints_fitted_together_are_as_each_fitted_alone() -> None:
    """Two joints lack samples, one has a spike, one a torque without value."""
    old = window(5)
    spoilt = spiked(old.joints[4], [60], 1.0, 0)
    values = old.joints[5].values.copy()
    values[7, 1] = np.nan
    mute = replace(old.joints[5], values=values)
    used = {
        2: without(old.joints[2], [10, 11, 150]),
        3: without(old.joints[3], [10, 11, 150]),
        4: without(old.joints[4], [60]),
    }
    given = old
    for k, new in (used | {4: spoilt, 5: mute}).items():
        given = with_joint(given, k, new)
    block = condition(given)
    for k in range(N):
        angle = used.get(k, old.joints[k])
        torque = without(old.joints[5], [7]) if k == 5 else used.get(k) if k != 4 else None
        by_order = [plain(angle, 0, NODES + 2, order) for order in range(3)]
        force = plain(torque or old.joints[k], 1, NODES - 1, 0)
        found = (block.q_rad, block.qd_rad_s, block.qdd_rad_s2)
        for (expected, operator), got in zip(by_order, found, strict=True):
            rounding = 1e-12 * np.abs(operator).sum(axis=1).max() * np.abs(angle.values[:, 0]).max()
            np.testing.assert_allclose(got[:, k], expected, rtol=1e-12, atol=rounding)
        np.testing.assert_allclose(block.tau_nm[:, k], force[0], rtol=1e-12, atol=1e-12)
        E = np.concatenate([by_order[order][1] for order in (1, 2, 0)])
        C = POSITION_NOISE_RAD**2 * E @ E.T
        np.testing.assert_allclose(block.cov_joint[k], C, rtol=1e-9, atol=1e-12 * C.max())
        C = TORQUE_NOISE_NM**2 * force[1] @ force[1].T
        np.testing.assert_allclose(block.cov_tau[k], C, rtol=1e-10, atol=1e-12 * C.max())
    assert block.has_joint.all()


def test_stamps_that_jitter_are_fitted_at_their_own_instants() -> None:
    """At 0.1 rad/s a stamp 20 us off is ten times the encoder's noise."""
    rng = np.random.default_rng(3)
    clean = window(6)
    jitter_ns = rng.integers(-20_000, 20_000, len(clean.joints[0].t_ns))
    old = clean.joints[0]
    rate_rad_s = np.gradient(old.values[:, 0], old.t_ns * 1e-9)
    values = old.values.copy()
    values[:, 0] += rate_rad_s * jitter_ns * 1e-9
    moved = replace(old, t_ns=old.t_ns + jitter_ns, values=values)
    expected = plain(moved, 0, NODES + 2, 1)[0]
    used = conditioner()
    used.condition(clean)  # whose instants are kept
    block = used.condition(with_joint(clean, 0, moved))
    assert block is not None
    np.testing.assert_allclose(block.qd_rad_s[:, 0], expected, rtol=1e-10, atol=1e-12)


def jittered(old: ChannelWindow, rng: np.random.Generator) -> ChannelWindow:
    return replace(old, t_ns=old.t_ns + rng.integers(-20_000, 20_000, len(old.t_ns)))


def all_sorts(rng: np.random.Generator) -> list[Window]:
    """Windows on an exact grid and on one that jitters; lacking samples, spoilt, and missing."""
    plain = [sampled_window(motion("target"), rng, 3.0 + WINDOW_S * k, k) for k in range(12)]
    lacking = with_joint(plain[3], 2, without(plain[3].joints[2], [0, 10, 11, 150]))
    lacking = replace(lacking, gyro=without(lacking.gyro, [7]))
    joints = tuple(without(joint, [5, 6]) for joint in plain[4].joints)
    spoilt = with_joint(plain[5], 1, spiked(plain[5].joints[1], [17, 90], 15.0, 1))
    spoilt = replace(spoilt, accelerometer=spiked(spoilt.accelerometer, [60], 2.0, 1))
    mute = plain[6].joints[4].values.copy()
    mute[7, 1] = np.nan
    few = without(plain[8].gyro, list(range(6, 200)))
    none = channel(np.empty(0), np.empty((0, 3)), missing=True)
    spread = [
        replace(w, joints=tuple(jittered(j, rng) for j in w.joints), gyro=jittered(w.gyro, rng))
        for w in plain[9:]
    ]
    found = [
        *plain[:3],
        lacking,
        replace(plain[4], joints=joints),
        spoilt,
        with_joint(plain[6], 4, replace(plain[6].joints[4], values=mute)),
        with_joint(plain[7], 0, replace(plain[7].joints[0], missing=True)),
        replace(plain[8], gyro=few, accelerometer=none),
        *spread,
    ]
    return [seen(w, valve_open=w.index == 6, solved=w.index % 3 == 1) for w in found]


def seen(old: Window, *, valve_open: bool, solved: bool) -> Window:
    """Add a valve, reported shut or suddenly open, and an attitude."""
    t_s = old.start_ns * 1e-9 + 0.02 * (np.arange(20) + 0.5)
    valve = channel(t_s, np.stack([np.full(20, float(valve_open)), np.zeros(20)], axis=1))
    attitude = channel(t_s[3:4], np.array([[0.0, 0.0, 0.6, 0.8]])) if solved else NO_ATTITUDE
    return replace(old, devices={"thrusters": (valve,)}, attitude=attitude)


def test_windows_given_together_have_the_blocks_and_findings_of_one_by_one() -> None:
    """To the bit: a recording that is replayed for a batch is what flew."""
    windows = all_sorts(np.random.default_rng(7))
    valve = ThrusterConfig.model_validate(thruster_settings(0))
    config = make_config().model_copy(update={"thrusters": (valve,)})
    alone, together, split = (Conditioner(config, tuple(range(N))) for _ in range(3))
    blocks = [alone.condition(window) for window in windows]
    parted = [*split.blocks(windows[:5]), *split.blocks([]), *split.blocks(windows[5:])]
    for at_once in (together.blocks(windows), parted):
        for own, other in zip(blocks, at_once, strict=True):
            assert (own is None) == (other is None)
            for field in fields(Block) if own and other else ():
                left, right = getattr(own, field.name), getattr(other, field.name)
                np.testing.assert_array_equal(left, right, err_msg=field.name)
    found = alone.findings()
    assert [block is None for block in blocks] == [k in (6, 7) for k in range(12)]
    known = [block.has_attitude for block in blocks if block is not None]
    assert known == [1 <= k < 6 for k in range(12) if k not in (6, 7)]
    subjects = [finding.subject for finding in found]
    assert subjects == [config.joints[1].name, "accelerometer", "valves", "valves"]
    for other in (together, split):
        assert other.findings() == found
        assert (other.outliers, other.unusable_windows) == (alone.outliers, 2) == (3, 2)


def test_instants_too_alike_for_a_polynomial_cost_their_own_window() -> None:
    rng = np.random.default_rng(8)
    good = [sampled_window(motion("target"), rng, 3.0 + WINDOW_S * k, k) for k in range(3)]
    centre_ns = (good[1].start_ns + good[1].stop_ns) // 2
    stuck = replace(good[1].joints[0], t_ns=np.full_like(good[1].joints[0].t_ns, centre_ns))
    given = [good[0], with_joint(good[1], 0, stuck), good[2]]
    blocks = conditioner().blocks(given)
    assert blocks[1] is None
    for k in (0, 2):
        assert blocks[k] is not None
        np.testing.assert_array_equal(blocks[k].q_rad, condition(good[k]).q_rad)


def test_clean_windows_have_no_outliers() -> None:
    tested = conditioner()
    rng = np.random.default_rng(5)
    for k in range(20):
        tested.condition(sampled_window(motion("target"), rng, 1.0 + 2.5 * k))
    assert tested.outliers == 0
    assert tested.unusable_windows == 0


def test_a_sensor_noisier_than_declared_degrades_but_keeps_its_samples() -> None:
    w = window()
    noise = 20 * 0.05 * np.random.default_rng(2).normal(size=len(w.joints[0].t_ns))
    values = w.joints[0].values.copy()
    values[:, 1] += noise
    tested = conditioner()
    assert tested.condition(with_joint(w, 0, replace(w.joints[0], values=values))) is not None
    assert tested.outliers == 0


def test_a_window_without_one_joint_is_unusable() -> None:
    w = window()
    tested = conditioner()
    assert tested.condition(with_joint(w, 3, replace(w.joints[3], missing=True))) is None
    assert tested.unusable_windows == 1


@pytest.mark.parametrize("name", ["gyro", "accelerometer"])
def test_a_missing_inertial_channel_is_marked_and_finite(name: str) -> None:
    w = window()
    empty = channel(np.empty(0), np.empty((0, 3)), missing=True)
    block = condition(replace(w, **{name: empty}))
    assert block.has_gyro == (name != "gyro")
    assert block.has_accelerometer == (name != "accelerometer")
    for field in fields(Block):
        assert np.all(np.isfinite(np.asarray(getattr(block, field.name), dtype=float)))


def test_a_window_of_nothing_but_junk_is_unusable_not_wrong() -> None:
    """Alternating huge values: whatever is decided, the block must not be silently precise."""
    w = window()
    values = w.gyro.values * 0 + 1e3 * np.random.default_rng(0).choice([-1, 1], w.gyro.values.shape)
    block = conditioner().condition(replace(w, gyro=replace(w.gyro, values=values)))
    assert block is not None
    assert np.all(np.isfinite(block.w_NB_B_rad_s))


def test_attitude_is_the_nearest_solution_turned_on_by_the_gyro() -> None:
    """One solution at the window's start, the truth's motion after it; then none in a window."""
    history = motion("target")
    unit = conditioner()
    first = window()
    solution_s = START_S + 0.02
    R = history.at(solution_s).R_NB
    q = Rotation.from_matrix(R).as_quat()[None]
    assert not unit.condition(first).has_attitude  # none has come yet
    seen = unit.condition(replace(first, attitude=channel(np.array([solution_s]), q)))
    rng = np.random.default_rng(1)
    after = unit.condition(sampled_window(history, rng, START_S + WINDOW_S, 1))
    for block in (seen, after):
        assert block.has_attitude
        true = history.at(block.t_ns * 1e-9).R_NB
        turn = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ block.R_NB).magnitude()
        assert turn.max() <= 1e-3  # the rate changes by 1e-3 rad/s within a window


def test_rotation_is_that_of_the_quaternion() -> None:
    q = np.random.default_rng(0).normal(size=(6, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    np.testing.assert_allclose(rotation_from_xyzw(q), rotation_matrices(q[:, [3, 0, 1, 2]]))


def test_friction_that_reverses_is_no_outlier_where_it_is_declared() -> None:
    """A step of 0.6 N m at a reversal: no sample is lost, and the torque is doubted."""
    t = (np.arange(200) + 0.5) / 500.0
    angle = 0.05 * (t - 0.01) ** 2
    torque = 0.3 * np.sign(t - 0.01)
    joints = tuple(channel(t, np.stack([angle, torque], axis=1)) for _ in range(N))
    inertial = channel(t, np.zeros((200, 3)))
    window = Window(
        index=0,
        start_ns=0,
        stop_ns=400_000_000,
        joints=joints,
        gyro=inertial,
        accelerometer=inertial,
        attitude=NO_ATTITUDE,
    )
    plain = make_config()
    quiet = [joint.model_copy(update={"torque_noise_nm": 0.01}) for joint in plain.joints]
    rubbing = [joint.model_copy(update={"friction_coulomb_sigma_nm": 0.3}) for joint in quiet]
    without, kept = (
        build_conditioner(plain.model_copy(update={"joints": own}), robot_model())
        for own in (quiet, rubbing)
    )
    blocks = [without.condition(window), kept.condition(window)]
    assert without.outliers > 0
    assert kept.outliers == 0
    doubted = [np.sqrt(block.cov_tau[0].diagonal().max()) for block in blocks if block is not None]
    assert doubted[0] < 0.005
    assert doubted[1] > 0.1


def test_a_window_in_which_declared_friction_reverses_does_not_tell_of_the_noise() -> None:
    """The step of a reversal is no noise; where the joint only moves one way, products are kept."""
    t = np.arange(200) / 500.0 - 0.2
    rng = np.random.default_rng(8)
    config = make_config()
    update = {"friction_coulomb_sigma_nm": 0.5, "friction_speed_rad_s": 0.01}
    joints = [joint.model_copy(update=update) for joint in config.joints]
    config = config.model_copy(update={"joints": joints})
    made = window(1)
    start_s = (made.start_ns + made.stop_ns) * 0.5e-9
    for first_rad_s, tells in ((0.0, False), (0.15, False), (0.5, True)):
        rate = first_rad_s + t
        torque = 0.4 * np.tanh(rate / 0.01) + rng.normal(scale=TORQUE_NOISE_NM, size=len(t))
        values = np.column_stack([first_rad_s * t + 0.5 * t**2, torque])
        moved = with_joint(made, 0, channel(start_s + t, values))
        block = Conditioner(config, tuple(range(N))).condition(moved)
        assert block is not None
        assert block.tau_products_nm2[:, 0].any() == tells, first_rad_s


@pytest.mark.parametrize("name", ["gyro", "accelerometer"])
def test_a_reading_that_is_left_out_is_one_that_never_came_to_the_bit(name: str) -> None:
    whole = window()
    own = getattr(whole, name)
    absurd = condition(replace(whole, **{name: spiked(own, [3, 17], 90.0, 1)}))
    missing = condition(replace(whole, **{name: without(own, [3, 17])}))
    for field in ("w_NB_B_rad_s", "wd_NB_B_rad_s2", "f_NS_B_m_s2", "R_NB", "cov_gyro", "cov_acc"):
        assert np.array_equal(getattr(absurd, field), getattr(missing, field)), field


def test_samples_at_one_count_share_their_error() -> None:
    """By hand: 8 samples; a run between steps of one sign is passed, others are held."""
    steady, still = np.arange(8.0), np.ones(8)
    assert held_samples(steady) == 1.0
    assert held_samples(still) == 8.0
    assert held_samples(np.repeat(np.arange(4.0), 2)) == (4 + 2 + 2 + 4) / 8
    turning = np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, 0.0, 0.0])
    assert held_samples(turning) == (1 + 1 + 9 + 1 + 4) / 8
