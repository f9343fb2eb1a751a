"""The model against Pinocchio's own algorithms; robots it must refuse."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from fsw.errors import ConfigError
from fsw.estimators.model.inertia import from_parameters, is_consistent
from fsw.estimators.model.robot import RobotModel
from tests.conftest import arm_urdf
from tests.support.estimator_cases import BASE, TARGET, TWO_ARMS, URDF, parameters


@pytest.fixture(params=["paper", "three joints", "two arms"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> RobotModel:
    if request.param == "paper":
        return RobotModel(URDF, "tool")
    if request.param == "two arms":
        return RobotModel(TWO_ARMS, "left_tool")
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    return RobotModel(path, "gripper")


def loaded(model: RobotModel) -> tuple[np.ndarray, pin.Model]:
    """Return parameters with base and target, set in the model, and an own Pinocchio model."""
    pi = model.total_parameters(parameters(BASE), parameters(TARGET))
    model.set_parameters(pi)
    own = model.model.copy()
    for k in range(1, own.njoints):
        own.inertias[k] = pin.Inertia.FromDynamicParameters(pi[10 * (k - 1) : 10 * k])
    return pi, own


def motion(model: RobotModel, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n = model.n
    return tuple(rng.normal(size=size) for size in (n, 3, n, 6 + n))


@pytest.mark.parametrize("seed", range(3))
def test_regressor_times_parameters_is_the_generalised_force(model: RobotModel, seed: int) -> None:
    pi, own = loaded(model)
    q, w, qd, a = motion(model, seed)
    v = np.concatenate([np.zeros(3), w, qd])
    full = np.concatenate([pin.neutral(own)[:7], q])
    force = pin.rnea(own, own.createData(), full, v, a)
    np.testing.assert_allclose(model.regressor(q, w, qd, a) @ pi, force, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_mass_matrix_is_full_symmetric_and_the_regressors(model: RobotModel, seed: int) -> None:
    pi, own = loaded(model)
    q = motion(model, seed)[0]
    H = model.mass_matrix(q).copy()
    full = np.concatenate([pin.neutral(own)[:7], q])
    crba = np.triu(pin.crba(own, own.createData(), full))
    np.testing.assert_allclose(H, crba + np.triu(crba, 1).T, rtol=1e-12, atol=1e-10)
    columns = [model.momentum_regressor(q, unit) @ pi for unit in np.eye(6 + model.n)]
    np.testing.assert_allclose(H, np.stack(columns, axis=1), rtol=1e-10, atol=1e-9)


def test_bias_derivative_is_the_derivative_of_the_force(model: RobotModel) -> None:
    _, own = loaded(model)
    q, w, qd, a = motion(model, 4)
    C = model.forces_and_derivatives(q[None], w[None], qd[None], a[None])[0][0].copy()
    full = np.concatenate([pin.neutral(own)[:7], q])
    v = np.concatenate([np.zeros(3), w, qd])
    data = own.createData()
    for k in range(len(v)):
        d = np.zeros(len(v))
        d[k] = 1e-5
        up, down = (pin.rnea(own, data, full, v + s * d, a) for s in (1, -1))
        np.testing.assert_allclose(C[:, k], (up - down) / 2e-5, atol=1e-5 * np.abs(C).max())


@pytest.mark.parametrize("seed", range(3))
def test_composite_is_mass_and_centre_of_mass_of_the_whole(model: RobotModel, seed: int) -> None:
    pi, own = loaded(model)
    q = motion(model, seed)[0]
    whole = model.composite(q) @ pi
    assert is_consistent(whole)
    mass, com, central = from_parameters(whole)
    data = own.createData()
    full = np.concatenate([pin.neutral(own)[:7], q])
    np.testing.assert_allclose(mass, pin.computeTotalMass(own), rtol=1e-12)
    np.testing.assert_allclose(com, pin.centerOfMass(own, data, full), rtol=1e-10, atol=1e-12)
    pin.ccrba(own, data, full, np.zeros(own.nv))
    M = data.Ig.inertia
    expected = [M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]]
    np.testing.assert_allclose(central, expected, rtol=1e-9, atol=1e-9 * np.abs(M).max())


def test_target_is_placed_at_the_tool_frame(model: RobotModel) -> None:
    name = {7: "tool", 3: "gripper", 14: "left_tool"}[model.n]
    frame = model.model.frames[model.model.getFrameId(name)]
    placed = frame.placement.act(pin.Inertia.FromDynamicParameters(parameters(TARGET)))
    np.testing.assert_allclose(
        model.tool.map @ parameters(TARGET), placed.toDynamicParameters(), rtol=1e-12, atol=1e-10
    )


def test_a_change_of_parameters_reaches_the_mass_matrix(model: RobotModel) -> None:
    q = motion(model, 0)[0]
    without = model.total_parameters(parameters(BASE), None)
    model.set_parameters(without)
    light = model.mass_matrix(q)[0, 0]
    model.set_parameters(model.total_parameters(parameters(BASE), parameters(TARGET)))
    assert model.mass_matrix(q)[0, 0] == pytest.approx(light + TARGET.mass_kg)


def test_joints_are_named_from_base_to_tool(model: RobotModel) -> None:
    arm = [f"joint{k}" for k in range(1, 8)]
    both = [f"{side}_{name}" for side in ("left", "right") for name in arm]
    names = {7: arm, 3: ["axis1", "axis2", "axis3"], 14: both}
    assert list(model.joint_names) == names[model.n]


@pytest.mark.parametrize(
    ("urdf", "frame", "word"),
    [
        (arm_urdf(3).replace("revolute", "floating", 1), "gripper", "axis1"),
        (arm_urdf(3), "claw", "claw"),
        (arm_urdf(3), "link1", "link1"),
        ("<robot", "gripper", "URDF"),
    ],
    ids=["floating", "unknown frame", "frame inside the arm", "no XML"],
)
def test_unsuitable_robots_are_refused(tmp_path: Path, urdf: str, frame: str, word: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(urdf)
    with pytest.raises(ConfigError, match=word):
        RobotModel(path, frame)


def test_a_continuous_joint_moves_as_a_revolute_one(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    forces = []
    for kind in ("revolute", "continuous"):
        path.write_text(arm_urdf(3, joint_type=kind))
        model = RobotModel(path, "gripper")
        rng = np.random.default_rng(0)
        q, qd, w, a = (rng.normal(size=size) for size in (3, 3, 3, 9))
        model.set_parameters(model.pi_links)
        states = 7.0 + q[None], w[None], qd[None], a[None]
        forces.append(model.forces_and_derivatives(*states)[1][0])
    np.testing.assert_array_equal(*forces)


@pytest.mark.parametrize("name", ["mount", "axis2", "link2"])
def test_a_link_is_found_beside_a_joint_of_its_name(tmp_path: Path, name: str) -> None:
    """Links and joints have separate name spaces; the link of a name is the frame."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    expected = RobotModel(path, "gripper").tool.map
    named = arm_urdf(3).replace('link name="gripper"', f'link name="{name}"')
    named = named.replace('link="gripper"', f'link="{name}"')
    if name == "link2":
        named = arm_urdf(3).replace('joint name="mount"', 'joint name="gripper"')
    path.write_text(named)
    model = RobotModel(path, "gripper" if name == "link2" else name)
    np.testing.assert_array_equal(model.tool.map, expected)


@pytest.mark.parametrize("seed", range(2))
def test_a_field_moves_every_body_of_both_arms(seed: int) -> None:
    """The torque of a joint by the field is the virtual work on the bodies beyond it."""
    model = RobotModel(TWO_ARMS, "left_tool")
    pi, own = loaded(model)
    rng = np.random.default_rng(seed)
    q, G = rng.normal(size=model.n), rng.normal(size=(3, 3))
    G = 0.5 * (G + G.T)

    def work_by(q_rad: np.ndarray) -> float:
        """Return the potential's negative: sum of m s.G s / 2 over all mass, G symmetric."""
        data = own.createData()
        pin.forwardKinematics(own, data, np.concatenate([pin.neutral(own)[:7], q_rad]))
        total = 0.0
        for k in range(1, own.njoints):
            body = own.inertias[k]
            R, p = data.oMi[k].rotation, data.oMi[k].act(body.lever)
            second = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia  # about its centre
            total += 0.5 * float(np.trace(G @ (R @ second @ R.T + body.mass * np.outer(p, p))))
        return total

    found = model.field_regressors(q[None], G[None])[0] @ pi
    for k in range(model.n):
        step = 1e-5 * np.eye(model.n)[k]
        expected = (work_by(q + step) - work_by(q - step)) / 2e-5
        assert found[6 + k] == pytest.approx(expected, rel=1e-5, abs=1e-4)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.urdf"):
        RobotModel(tmp_path / "none.urdf", "tool")


@pytest.mark.parametrize("name", ["root_joint", "universe", "base"])
def test_a_joint_may_have_the_name_of_the_librarys_base(tmp_path: Path, name: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    expected = RobotModel(path, "gripper")
    path.write_text(arm_urdf(3).replace('joint name="axis1"', f'joint name="{name}"'))
    model = RobotModel(path, "gripper")
    assert model.joint_names == (name, "axis2", "axis3")
    np.testing.assert_array_equal(model.pi_links, expected.pi_links)
    np.testing.assert_array_equal(model.parents, expected.parents)


def test_a_tool_frame_before_a_joint_names_the_joint(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    with pytest.raises(ConfigError, match=r"moves with 'axis2', and 'axis3' comes after; .*fixed"):
        RobotModel(path, "link2")
