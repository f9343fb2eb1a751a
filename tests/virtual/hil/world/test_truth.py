"""The truth keeps physics' own balances and agrees with an independent engine."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import simpson

from hil.world.stand import Stand
from hil.world.truth import TruthHistory, simulate
from tests.support.truth_cases import Case, pin_state, random_arm, stand_in, two_arms

NAMES = ("base", "target_leo", "target_geo", "random", "two arms")


@pytest.fixture(scope="module", params=NAMES)
def run(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Case, TruthHistory]:
    if request.param == "random":
        case = random_arm(tmp_path_factory.mktemp("robot"))
    elif request.param == "two arms":
        case = two_arms()
    else:
        case = stand_in(None if request.param == "base" else request.param)
    return case, simulate(case.robot, case.spline, -1.0, 21.0)


def test_momentum_about_the_centre_of_mass_stays_zero(run: tuple[Case, TruthHistory]) -> None:
    case, history = run
    data = case.model.createData()
    state = history.at(history.t_s[::50])
    total, arm = [], []
    for k in range(len(state.t_s)):
        q, v, _ = pin_state(state, k)
        total.append(pin.computeCentroidalMomentum(case.model, data, q, v).vector.copy())
        v[:6] = 0.0
        arm.append(pin.computeCentroidalMomentum(case.model, data, q, v).vector.copy())
    for part in (slice(0, 3), slice(3, 6)):
        scale = np.linalg.norm(np.array(arm)[:, part], axis=1).max()
        assert np.abs(np.array(total)[:, part]).max() <= 1e-9 * scale


def test_kinetic_energy_is_the_work_of_the_joints(run: tuple[Case, TruthHistory]) -> None:
    case, history = run
    data = case.model.createData()
    power = np.sum(history.tau * history.qd, axis=1)
    state = history.at(history.t_s[::200])
    energy = []
    for k in range(len(state.t_s)):
        q, v, _ = pin_state(state, k)
        energy.append(pin.computeKineticEnergy(case.model, data, q, v))
    work = [simpson(power[: 200 * k + 1], dx=history.dt_s) for k in range(1, len(energy))]
    assert np.abs(np.array(energy[1:]) - work).max() <= 1e-6 * max(energy)


@pytest.mark.parametrize("shift_s", [0.0, 0.001, 0.002])
def test_inverse_dynamics_of_another_engine_gives_the_torques_and_no_base_wrench(
    run: tuple[Case, TruthHistory], shift_s: float
) -> None:
    case, history = run
    data = case.model.createData()
    state = history.at(history.t_s[:-1:50] + shift_s)
    wrenches = np.array(
        [pin.rnea(case.model, data, *pin_state(state, k)) for k in range(len(state.t_s))]
    )
    scale = np.abs(state.tau).max()
    assert np.abs(wrenches[:, 6:] - state.tau).max() <= 1e-6 * scale
    assert np.abs(wrenches[:, :6]).max() <= 1e-6 * scale


def test_joints_follow_the_spline(run: tuple[Case, TruthHistory]) -> None:
    case, history = run
    wanted = case.spline.evaluate(history.t_s)
    for got, want in zip((history.q, history.qd, history.qdd), wanted, strict=True):
        assert np.abs(got - want).max() <= 1e-8


def test_rest_before_and_after_the_motion(run: tuple[Case, TruthHistory]) -> None:
    _, history = run
    before, after = history.at(-0.5), history.at(20.5)
    for still in (before.w_NB_B, before.v_NB_N, before.tau):
        assert np.abs(still).max() == 0.0
    assert np.abs(after.qd).max() <= 1e-9
    assert np.abs(after.w_NB_B).max() <= 1e-9
    assert np.abs(history.at(10.0).w_NB_B).max() > 1e-4


def test_interpolation_agrees_with_a_finer_simulation(run: tuple[Case, TruthHistory]) -> None:
    case, history = run
    fine = simulate(case.robot, case.spline, -1.0, 21.0, 0.001)
    a, b = history.at(fine.t_s), fine.at(fine.t_s)
    # Accelerations and torques lose an order where the spline's fifth derivative jumps.
    bounds = dict.fromkeys(("q", "qd", "p_NB_N", "v_NB_N", "R_NB", "w_NB_B"), 1e-8)
    bounds |= dict.fromkeys(("qdd", "tau", "wd_NB_B", "a_NB_B"), 1e-6)
    for name, bound in bounds.items():
        got, want = getattr(a, name), getattr(b, name)
        assert np.abs(got - want).max() <= bound * np.abs(want).max(), name


def test_interpolated_rates_are_derivatives_of_interpolated_positions(
    run: tuple[Case, TruthHistory],
) -> None:
    _, history = run
    t, h = np.linspace(1.0, 19.0, 200), 1e-3
    less, here, more = history.at(t - h), history.at(t), history.at(t + h)
    for value, rate in (("q", "qd"), ("qd", "qdd"), ("p_NB_N", "v_NB_N"), ("w_NB_B", "wd_NB_B")):
        slope = (getattr(more, value) - getattr(less, value)) / (2 * h)
        assert np.abs(slope - getattr(here, rate)).max() <= 1e-6
    turn = np.einsum("kji,kjl->kil", here.R_NB, (more.R_NB - less.R_NB) / (2 * h))
    w = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=-1)
    assert np.abs(w - here.w_NB_B).max() <= 1e-6


def test_shapes_follow_the_asked_times() -> None:
    case = stand_in(None)
    history = simulate(case.robot, case.spline, 0.0, 1.0)
    single, grid = history.at(0.5), history.at(np.full((2, 3), 0.5))
    assert single.q.shape == (7,)
    assert grid.R_NB.shape == (2, 3, 3, 3)
    assert np.array_equal(grid.tau[1, 2], single.tau)
    with pytest.raises(ValueError, match="outside the history"):
        history.at(1.1)


def test_start_attitude_turns_everything_inertial_and_nothing_else() -> None:
    case = stand_in("target_leo")
    q = (0.5, -0.5, 0.1, 0.7)
    plain = simulate(case.robot, case.spline, 0.0, 10.0).at([2.0, 9.0])
    turned = simulate(case.robot, case.spline, 0.0, 10.0, q_NB_xyzw=q).at([2.0, 9.0])
    R = pin.Quaternion(np.array(q) / np.linalg.norm(q)).matrix()
    assert np.abs(turned.tau - plain.tau).max() <= 1e-9
    assert np.abs(turned.a_NB_B - plain.a_NB_B).max() <= 1e-12
    assert np.abs(turned.R_NB - R @ plain.R_NB).max() <= 1e-12
    assert np.abs(turned.p_NB_N - plain.p_NB_N @ R.T).max() <= 1e-12


def test_wrench_changes_the_momentum_by_its_impulse() -> None:
    case = stand_in("target_leo")
    model, data = case.model, case.model.createData()
    base = case.robot.model.body("base").id
    force = np.array([0.3, -0.2, 0.5])

    def push(_t: float, mujoco_data: object) -> None:
        mujoco_data.xfrc_applied[base, :3] = force  # type: ignore[attr-defined]

    history = simulate(case.robot, case.spline, 0.0, 4.0, wrench=push)
    state = history.at([4.0])
    q, v, _ = pin_state(state, 0)
    momentum = pin.computeCentroidalMomentum(model, data, q, v).linear
    assert np.abs(momentum - 4.0 * force).max() <= 1e-6
    assert np.abs(history.q - case.spline.evaluate(history.t_s)[0]).max() > 0.0


def test_a_tumbling_robot_keeps_its_momentum_and_another_engine_finds_its_torques() -> None:
    case = stand_in("target_leo")
    rate = (0.03, -0.02, 0.05)
    data = case.model.createData()
    history = simulate(case.robot, case.spline, -4.0, 21.0, w_NB_B_rad_s=rate)
    state = history.at(history.t_s[::200])
    assert np.array_equal(state.w_NB_B[0], rate)
    momenta, wrenches = [], []
    for k in range(len(state.t_s)):
        pose = pin_state(state, k)
        momenta.append(pin.computeCentroidalMomentum(case.model, data, *pose[:2]).vector.copy())
        wrenches.append(pin.rnea(case.model, data, *pose))
    momenta, wrenches = np.array(momenta), np.array(wrenches)
    assert np.linalg.norm(momenta[0, 3:]) > 30.0
    assert np.abs(momenta[:, :3]).max() <= 1e-6  # the whole's centre of mass rests
    assert np.ptp(momenta[:, 3:], axis=0).max() <= 1e-6
    scale = np.abs(state.tau).max()
    assert np.abs(wrenches[:, 6:] - state.tau).max() <= 1e-6 * scale
    assert np.abs(wrenches[:, :6]).max() <= 1e-6 * scale


def test_a_base_on_a_stand_does_not_tumble() -> None:
    case = stand_in(None)
    with pytest.raises(ValueError, match="does not tumble"):
        simulate(
            case.robot,
            case.spline,
            0.0,
            1.0,
            stand=Stand(motion="clamped"),
            w_NB_B_rad_s=(0.0, 0.0, 0.1),
        )


def test_wrong_joint_count_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="spline has 7 joints, robot 3"):
        simulate(random_arm(tmp_path).robot, stand_in(None).spline, 0.0, 1.0)
