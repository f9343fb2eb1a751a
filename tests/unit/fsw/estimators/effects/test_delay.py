"""Delays as states: derivatives in every method, noise, the remainder, configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.batch.solver import solve
from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.measurement.prediction import Prediction
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import (
    NODES,
    WINDOW_S,
    N,
    make_config,
    motion,
    noisy,
    random_block,
    robot_model,
    true_block,
)
from tests.support.one_block import fused_rows, mrnea_rows
from tests.support.slopes import (
    assert_row_slopes,
    assert_state_slopes,
    named,
    off_the_prior,
    predicted_fields,
)
from tests.support.wheel_cases import wheel_settings
from tests.support.wrench_cases import with_wrist, wrist_problem

SIGMA_S = 0.01
NOT_DELAYED = {"torque": np.zeros(N), "acc": np.zeros(3), "gyro": np.zeros(3)}
KINDS = ("torque_delay", "bus_delay", "imu_delay")


def with_delays(
    config: Config, *, joints: float = SIGMA_S, buses: float = SIGMA_S, imu: float = SIGMA_S
) -> Config:
    """Return the configuration with sigmas of delays, and the last three joints on a second bus."""
    own = config.model_dump()
    own["buses"] = [own["buses"][0], own["buses"][0] | {"name": "hand", "channel": "b"}]
    for k, joint in enumerate(own["joints"]):
        joint |= {"torque_delay_sigma_s": joints, "bus": "arm" if k < 4 else "hand"}
    for bus in own["buses"]:
        bus["delay_sigma_s"] = buses
    own["imu"]["delay_sigma_s"] = imu
    return config.with_sections(**{key: own[key] for key in ("buses", "joints", "imu")})


def problem_and_state(*, doubt: bool = True, **options: Any) -> tuple[Problem, np.ndarray]:
    problem = build_problem(with_delays(make_config(doubt=doubt, **options)), robot_model())
    problem = replace(problem, angles_are_noisy=True)
    x = off_the_prior(problem)
    x[problem.inertial] = problem.prior_mean[problem.inertial]
    return problem, x


def own_columns(problem: Problem) -> list[int]:
    kinds = (*KINDS, "torque_scale", "torque_offset", "joint_zero", "gyro_bias", "imu_angle")
    return named(problem, *kinds)


def whole(at: Prediction) -> np.ndarray:
    return np.concatenate([at.tau_nm, at.f_m_s2, at.w_rad_s], axis=1)


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_predictions_derivatives_by_the_state(rate: Any) -> None:
    problem, x = problem_and_state()
    block = random_block(2)
    assert len(named(problem, *KINDS)) == N + 2 + 2
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        *(x, 1e-6),
        rtol=0.0,
        of_slope=1e-5,
        absolute=1e-9,
        fields=predicted_fields(rate),
        states=own_columns(problem),
    )


def test_rows_are_those_of_the_readings_without_delay() -> None:
    """Where the readings are as predicted, A = -db/dx: the weights follow the state, b is zero."""
    problem, x = problem_and_state(doubt=False)
    exact = replace(problem, angles_are_noisy=False)
    at = predict(random_block(2), x, exact)
    block = replace(
        random_block(2), tau_nm=at.tau_nm, f_NS_B_m_s2=at.f_m_s2, w_NB_B_rad_s=at.w_rad_s
    )
    assert np.abs(fused_rows(block, x, exact).b).max() < 1e-9
    own = own_columns(exact)
    assert_row_slopes(lambda x: fused_rows(block, x, exact), x, 1e-6, own, of_slope=1e-5)


def test_rows_of_the_regression() -> None:
    """Readings that the regression explains: late ones of a motion, by the model's own torques."""
    problem, x = problem_and_state(doubt=False, method="mrnea", weighting="ols")
    still, h = np.where(np.isin(np.arange(len(x)), problem.delays.states), 0.0, x), 1e-6
    block = random_block(4)
    w, f = block.w_NB_B_rad_s, block.f_NS_B_m_s2
    block = replace(block, wd_NB_B_rad_s2=problem.delays.slope(w, NODES))
    rows = mrnea_rows(block, still, problem, "ols")
    own = [k for k, name in enumerate(problem.names) if name.startswith(("imu_delay", "bus_delay"))]
    assert len(own) == 4
    for k in own:
        b = [mrnea_rows(block, still + s * np.eye(len(x))[k], problem, "ols").b for s in (h, -h)]
        expected = ((b[1] - b[0]) / (2 * h)).reshape(NODES, -1)[:, :6]  # base rows: no torque
        found = rows.A[:, k].reshape(NODES, -1)[:, :6]
        assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max(), (k, f)
    # torque rows: -slope of the predicted torque, so the difference is that of the residual
    k = problem.names.index("torque_delay.joint3")
    b = [mrnea_rows(block, still + s * np.eye(len(x))[k], problem, "ols").b for s in (h, -h)]
    expected = ((b[1] - b[0]) / (2 * h)).reshape(NODES, -1)[:, 6 + 2]
    left = rows.b.reshape(NODES, -1)[:, 6 + 2 : 6 + 3]
    expected = expected + problem.delays.slope(left, NODES)[:, 0]
    found = rows.A[:, k].reshape(NODES, -1)[:, 6 + 2]
    assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max()


def test_noise_of_a_torque_counts_through_its_delay() -> None:
    """The rows' covariance against 400 draws of the torques, at a delay of a tenth of a window."""
    problem, x = problem_and_state(doubt=False)
    x[problem.at("torque_delay")] = 0.1 * WINDOW_S
    block = random_block(2)
    back = problem.delays.back(x, NODES)
    s = BlockStack((block,)).noise_through(back)
    use = np.r_[np.ones(N, bool), np.zeros(6, bool)]
    still = replace(block, cov_joint=np.zeros_like(block.cov_joint))
    own = BlockStack((still,)).noise_through(back)
    S = residual_covariance(own, predict(still, x, problem), use, "momentum")[0]
    assert s.cov_tau.shape == (1, N, NODES, NODES)
    rng, count = np.random.default_rng(8), 400
    roots = np.linalg.cholesky(block.cov_tau)
    drawn = [
        problem.delays.prompt(
            x,
            np.pad((roots @ rng.normal(size=(N, NODES, 1)))[:, :, 0].T, ((0, 0), (0, 6))),
            NODES,
        )[:, :N].ravel()
        for _ in range(count)
    ]
    white = np.linalg.solve(np.linalg.cholesky(S), np.array(drawn).T)
    # variance of each of 28 white values: 1 within 5 sigma of a sample variance of 400 draws
    assert np.abs(np.mean(white**2, axis=1) - 1.0).max() < 5.0 * np.sqrt(2.0 / count)


@pytest.mark.parametrize(("rate_hz", "bound"), [(1.0, 7e-3), (0.3, 6e-5)])
def test_remainder_at_ten_milliseconds(rate_hz: float, bound: float) -> None:
    """Samples of a delayed sine, fitted as the conditioner does, against the shifted prediction."""
    problem, x = problem_and_state(doubt=False)
    x[:] = 0.0
    x[problem.at("torque_delay")] = 0.01
    t = (np.arange(200) + 0.5) / 500.0 - 0.5 * WINDOW_S
    fit = NodeFit(t, 0.5 * WINDOW_S, NODES - 1, NODES)
    nodes_s, worst = 0.5 * WINDOW_S * gauss_nodes(NODES), 0.0
    for phase in np.linspace(0.0, np.pi, 24):
        late, prompt = (
            np.sin(2 * np.pi * rate_hz * (times - d) + phase)[:, None]
            for times, d in ((t, 0.01), (nodes_s, 0.0))
        )
        at_nodes = fit.operators((0,)) @ fit.coefficients(late)
        clean = fit.operators((0,)) @ fit.coefficients(
            np.sin(2 * np.pi * rate_hz * t + phase)[:, None]
        )
        no_delay = np.abs(clean - prompt).max()
        J = np.zeros((NODES, 1, len(x)))
        shifted = problem.delays.late(x, prompt, J, NODES)
        worst = max(worst, float(np.abs(shifted - at_nodes).max() - no_delay))
    assert worst < bound


def readings(*, torque_s: float = 0.0, hand_s: float = 0.0, imu_s: float = 0.0) -> list[Block]:
    """Return 40 noisy blocks of the target's motion with delays in seconds.

    `torque_s`: of the torque of joint 2; `hand_s`: of all samples of joints 5 to 7; `imu_s`: of the
    inertial unit.
    """
    history, rng, blocks = motion("target"), np.random.default_rng(1), []
    for k in range(40):
        start_s = 1.0 + WINDOW_S * k
        now, torque, hand, unit = (
            true_block(history, start_s - d, k) for d in (0.0, torque_s, hand_s, imu_s)
        )
        tau, motions = now.tau_nm.copy(), {}
        tau[:, 1], tau[:, 4:] = torque.tau_nm[:, 1], hand.tau_nm[:, 4:]
        for key in ("q_rad", "qd_rad_s", "qdd_rad_s2"):
            motions[key] = np.concatenate([getattr(now, key)[:, :4], getattr(hand, key)[:, 4:]], 1)
        names = ("w_NB_B_rad_s", "wd_NB_B_rad_s2", "f_NS_B_m_s2")
        of_unit = {key: getattr(unit, key) for key in names}
        block = replace(now, tau_nm=tau, **motions, **of_unit)
        blocks.append(noisy(block, rng, NOT_DELAYED))
    return blocks


@pytest.mark.parametrize(
    ("late", "against_unit", "names", "true_s"),
    [
        ({"torque_s": 0.01}, {"buses": 0.0}, ["torque_delay.joint2"], 0.01),
        ({"imu_s": 0.01}, {"buses": 0.0}, ["imu_delay.gyro"], 0.01),
        ({"imu_s": -0.008}, {"imu": 0.0}, ["bus_delay.arm"], 0.008),  # both buses are late
        ({"imu_s": -0.008}, {"imu": 0.0}, ["bus_delay.hand"], 0.008),
        ({"hand_s": 0.008}, {}, ["bus_delay.hand", "bus_delay.arm"], 0.008),  # one by the other
    ],
)
def test_late_readings_show_as_the_delay_of_their_device(
    late: dict[str, float], against_unit: dict[str, float], names: list[str], true_s: float
) -> None:
    problem = build_problem(with_delays(make_config(), **against_unit), robot_model())
    solution = solve(problem, row_function("fused", "eiv", problem), readings(**late))
    assert solution.status == "OK"
    weights = np.zeros(len(problem.names))
    for name, weight in zip(names, (1.0, -1.0), strict=False):
        weights[problem.names.index(name)] = weight
    sigma_s = float(np.sqrt(weights @ solution.information.covariance() @ weights))
    assert sigma_s < 0.1 * SIGMA_S
    assert abs(weights @ solution.mean - true_s) < 3.0 * sigma_s


def test_a_single_bus_is_the_clock_unless_the_base_turns_wheels() -> None:
    """Then the reports of the wheels are on the base's clock, and the joints' motion is moved."""
    plain = make_config()
    late = plain.with_sections(buses=[plain.buses[0].model_dump() | {"delay_sigma_s": SIGMA_S}])
    own = build_problem(late, robot_model()).delays
    assert not own.moves_joints
    np.testing.assert_array_equal(own.of_channels[:, 0], [*[0.0] * N, *[-1.0] * 6])
    turning = build_problem(late.with_sections(wheels=[wheel_settings(0)]), robot_model()).delays
    np.testing.assert_array_equal(turning.of_joints, np.ones((N, 1)))
    np.testing.assert_array_equal(turning.of_channels[:, 0], [*[1.0] * N, *[0.0] * 6])


def test_a_known_delay_is_no_state_and_acts_all_the_same() -> None:
    config = make_config()
    late = [j.model_copy(update={"torque_delay_s": 0.01}) for j in config.joints]
    known = build_problem(config.model_copy(update={"joints": tuple(late)}), robot_model())
    problem = build_problem(with_delays(config, buses=0.0, imu=0.0), robot_model())
    x = np.concatenate([known.prior_mean, np.full(N, 0.01)])
    block = random_block(2)
    np.testing.assert_allclose(
        whole(predict(block, known.prior_mean, known)), whole(predict(block, x, problem))
    )


@pytest.mark.parametrize(
    ("sizes", "line"),
    [
        ({"buses": 0.0, "imu": 0.0}, r"joints\.0\.torque_delay_sigma_s: 0\.01; .*'ce'.* must be 0"),
        ({"joints": 0.0, "imu": 0.0}, r"buses\.0\.delay_sigma_s: 0\.01; .*'ce'.* must be 0"),
    ],
)
def test_energy_refuses_delays_by_key_value_and_bound(sizes: dict[str, float], line: str) -> None:
    config = with_delays(make_config(), **sizes)
    with pytest.raises(ConfigError, match=rf"^{line}$"):
        run_batch(config, [random_block(2)], "ce", ("target",))


@pytest.mark.parametrize(
    ("sizes", "key", "bound"),
    [
        ({"joints": 0.05}, "joints.0.torque_delay_sigma_s", "0.05 must be at most 0.1"),
        ({"buses": 0.041}, "buses.0.delay_sigma_s", "0.04"),
        ({"imu": 0.041}, "imu.delay_sigma_s", "0.04"),
        ({"imu": 0.2}, "imu.delay_sigma_s", "0.1"),
        ({"joints": -0.01}, "joints.0.torque_delay_sigma_s", "greater than or equal to 0|at least"),
    ],
)
def test_a_delay_beyond_a_tenth_of_a_window_is_refused(
    sizes: dict[str, float], key: str, bound: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        with_delays(make_config(), **sizes)
    text = str(refused.value)
    assert text.startswith(key), text
    assert any(word in text for word in bound.split("|")), text


def test_without_the_keys_nothing_changes() -> None:
    problem = build_problem(make_config(doubt=True), robot_model())
    assert not problem.delays
    assert not [name for name in problem.names if name.startswith(KINDS)]
    assert problem.watched is None or not [n for n in problem.watched.names if n.startswith(KINDS)]


def test_a_wrench_sensor_is_timed_by_the_base() -> None:
    """Its samples come from no bus, so that those of the clock of a bus are advanced."""
    config = with_wrist(make_config())
    late = config.with_sections(buses=[config.buses[0].model_dump() | {"delay_sigma_s": SIGMA_S}])
    own = wrist_problem(late).delays
    np.testing.assert_array_equal(own.of_channels[:, 0], [*[0.0] * N, *[-1.0] * 12])
