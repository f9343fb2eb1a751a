"""A force-torque sensor in the arm: closed forms, Pinocchio's forces, derivatives, its errors."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from fsw.errors import ConfigError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.model.wrench_sensor import WrenchSensor
from tests.support.estimator_cases import (
    TARGET,
    URDF,
    N,
    make_config,
    parameters,
    true_blocks_cached,
    wrong,
)
from tests.support.one_block import fused_rows
from tests.support.wrench_cases import (
    GRAVITY,
    PLACE,
    TURN,
    plain_model,
    with_axes,
    with_wrist,
    wrist_block,
    wrist_problem,
)


def sensor(frame: str) -> WrenchSensor:
    return WrenchSensor(name="wrist", key="wrench_sensors.0.frame", frame=frame)


def tool_pose(q: np.ndarray) -> pin.SE3:
    own = pin.buildModelFromUrdf(str(URDF), pin.JointModelFreeFlyer())
    data = own.createData()
    pin.framesForwardKinematics(own, data, np.concatenate([pin.neutral(own)[:7], q]))
    return data.oMf[own.getFrameId("tool")].copy()


def test_a_resting_body_has_the_wrench_of_its_weight():
    """force = -m g, torque = c x force, about S and in its axes: what holds the body up."""
    config = with_wrist(
        make_config(biases=False), "clamped", GRAVITY, p_FS_m=PLACE, rpy_FS_rad=TURN
    )
    problem, block = wrist_problem(config), wrist_block()
    still = np.zeros_like(block.q_rad)
    block = replace(block, qd_rad_s=still, qdd_rad_s2=still)
    x = problem.prior_mean
    found = predict(block, x, problem).tau_nm[:, N:]
    R_ES = pin.rpy.rpyToMatrix(*TURN)
    for q, wrench in zip(block.q_rad, found, strict=True):
        R_BS = tool_pose(q).rotation @ R_ES
        force = -TARGET.mass_kg * R_BS.T @ np.array(GRAVITY)
        lever = R_ES.T @ (np.array(TARGET.com_m) - PLACE)
        np.testing.assert_allclose(wrench[:3], force, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(wrench[3:], np.cross(lever, force), rtol=1e-12, atol=1e-9)


def test_a_spinning_body_pulls_outwards():
    """At a constant rate about a fixed axis the force is m w x (w x r): it points to the axis."""
    problem = wrist_problem(with_wrist(make_config(biases=False), "clamped"))
    block, rate_rad_s = wrist_block(), 0.7
    qd = np.zeros_like(block.qd_rad_s)
    qd[:, 0] = rate_rad_s
    block = replace(block, qd_rad_s=qd, qdd_rad_s2=np.zeros_like(qd))
    found = predict(block, problem.prior_mean, problem).tau_nm[:, N:]
    own = pin.buildModelFromUrdf(str(URDF), pin.JointModelFreeFlyer())
    data = own.createData()
    for q, wrench in zip(block.q_rad, found, strict=True):
        whole = np.concatenate([pin.neutral(own)[:7], q])
        axis = pin.computeJointJacobian(own, data, whole, 2)[3:, 6]
        pin.forwardKinematics(own, data, whole)
        joint, tool = data.oMi[2], tool_pose(q)
        w = rate_rad_s * joint.rotation @ axis
        r = tool.translation + tool.rotation @ np.array(TARGET.com_m) - joint.translation
        force = TARGET.mass_kg * tool.rotation.T @ np.cross(w, np.cross(w, r))
        np.testing.assert_allclose(wrench[:3], force, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("joint", [3, 7])
def test_the_wrench_is_pinocchios_force_on_the_link(joint: int):
    """The sensor before a link in mid arm measures the force that its joint transmits."""
    place = {"p_FS_m": PLACE, "rpy_FS_rad": TURN, "frame": f"link{joint}"}
    problem = wrist_problem(with_wrist(make_config(biases=False), **place))
    plain = wrist_problem(make_config(biases=False))
    block, x = wrist_block(3), problem.prior_mean
    found = predict(block, x, problem)
    ordinary = predict(replace(block, tau_nm=block.tau_nm[:, :N]), plain.prior_mean, plain)
    np.testing.assert_allclose(found.tau_nm[:, :N], ordinary.tau_nm, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(found.w_rad_s, ordinary.w_rad_s, rtol=1e-10, atol=1e-12)
    own = plain_model(plain.pi(plain.prior_mean))
    data = own.createData()
    X_FS = pin.SE3(pin.rpy.rpyToMatrix(*TURN), np.array(PLACE))
    for i, q in enumerate(block.q_rad):
        whole = np.concatenate([pin.neutral(own)[:7], q])
        w = ordinary.w_rad_s[i]
        v = np.concatenate([np.zeros(3), w, block.qd_rad_s[i]])
        a = np.concatenate([np.zeros(6), block.qdd_rad_s2[i]])
        H = pin.crba(own, data, whole)
        H = np.triu(H) + np.triu(H, 1).T
        a[:6] = -np.linalg.solve(H[:6, :6], pin.rnea(own, data, whole, v, a)[:6])
        pin.rnea(own, data, whole, v, a)
        expected = X_FS.actInv(data.f[joint + 1]).vector
        np.testing.assert_allclose(found.tau_nm[i, N:], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_derivatives_by_state_and_motion_agree_with_differences(rate: str):
    config = make_config(("base", "target"), doubt=True, momentum_sigma_nms=1.0)
    config = with_wrist(
        config, frame="link6", p_FS_m=PLACE, rpy_FS_rad=TURN, scale_sigma_ratio=0.02
    )
    problem = replace(wrist_problem(config), angles_are_noisy=True)
    block = replace(wrist_block(2), cov_joint=np.stack([1e-6 * np.eye(12)] * N))
    x = problem.prior_mean.copy()
    own = [k for k, name in enumerate(problem.names) if name.startswith("wrench")]
    assert len(own) == 12
    x[own] = np.random.default_rng(5).normal(size=12) * 0.05

    def wrench(state: np.ndarray, b=block) -> np.ndarray:
        return predict(b, state, problem, rate).tau_nm[:, N:]

    at = predict(block, x, problem, rate)
    for k, name in enumerate(problem.names):
        d = np.zeros_like(x)
        d[k] = 1e-4 * max(1.0, abs(x[k]))
        expected = (wrench(x + d) - wrench(x - d)) / (2.0 * d[k])
        rounding = 1e-13 * np.abs(wrench(x)).max() / d[k]
        got = at.J[:, N : N + 6, k]
        assert np.abs(got - expected).max() <= 1e-6 * np.abs(expected).max() + rounding, name
    for D, field in ((at.D_qdd, "qdd_rad_s2"), (at.D_qd, "qd_rad_s"), (at.D_q, "q_rad")):
        for k in range(N):
            step = np.zeros(N)
            step[k] = 1e-5
            up, down = (
                wrench(x, replace(block, **{field: getattr(block, field) + s * step}))
                for s in (1, -1)
            )
            expected = (up - down) / 2e-5
            limit = 1e-6 * np.abs(expected).max() + 1e-6
            assert np.abs(D[:, N : N + 6, k] - expected).max() <= limit, (field, k)


def test_every_axis_has_its_offset_and_its_scale():
    """measured = wrench (1 + scale) + offset."""
    config = with_wrist(make_config(biases=False), scale_sigma_ratio=0.02)
    problem, block = wrist_problem(config), wrist_block()
    x = problem.prior_mean.copy()
    true = predict(block, x, problem).tau_nm[:, N:]
    x[problem.at("wrench_offset")] = np.arange(6.0)
    x[problem.at("wrench_scale")] = 0.01 * np.arange(6.0)
    expected = true * (1.0 + 0.01 * np.arange(6.0)) + np.arange(6.0)
    np.testing.assert_allclose(predict(block, x, problem).tau_nm[:, N:], expected, rtol=1e-12)


def test_the_wrist_alone_finds_the_target_and_its_own_offsets():
    """From a prior 30 to 50 % off, without noise; the joints' torques are not used."""
    far = wrong(TARGET, np.random.default_rng(4))
    truth = make_config(biases=False)
    offset = np.array([1.0, -2.0, 0.5, 0.05, -0.1, 0.02])
    exact = wrist_problem(with_wrist(truth))
    blocks = []
    for block in true_blocks_cached("target", 24.0):
        own = with_axes(block)
        wrench = predict(own, parameters_of(exact), exact).tau_nm[:, N:] + offset
        tau = np.concatenate([block.tau_nm, wrench], axis=1)
        usable = np.concatenate([np.zeros(N, np.bool_), np.ones(6, np.bool_)])
        blocks.append(replace(own, tau_nm=tau, has_joint=usable))
    config = with_wrist(make_config(target=far, biases=False))
    found = run_batch(config, blocks, "fused", ())
    mean, sigma = (np.array(found[key]) for key in ("mean", "covariance"))
    sigma = np.sqrt(np.diag(sigma))
    names = list(found["names"])
    assert np.all(np.abs(mean[:10] - parameters(TARGET)) < 0.05 * sigma[:10])
    own = [k for k, name in enumerate(names) if name.startswith("wrench_offset")]
    assert np.all(np.abs(mean[own] - offset) < 0.05 * sigma[own] + 1e-6)


def parameters_of(problem) -> np.ndarray:
    x = problem.prior_mean.copy()
    x[:10] = parameters(TARGET)
    return x


def test_rows_hold_the_axes_in_use_only():
    problem, block = wrist_problem(with_wrist(make_config())), wrist_block()
    usable = block.has_joint.copy()
    usable[N + 1] = False
    rows = fused_rows(replace(block, has_joint=usable), problem.prior_mean, problem)
    assert rows.torques == N + 5
    assert len(rows.b) == len(block.t_ns) * (N + 5 + 6)


def test_links_beyond_the_sensor_are_bodies_of_their_own():
    """The robot's mass is that without a sensor, and the sensor is an uncertain body too."""
    plain, model = RobotModel(URDF, "tool"), RobotModel(URDF, "tool", None, [sensor("link7")])
    assert model.body_names == ("base", *(f"joint{k + 1}" for k in range(7)), "wrist")
    pi = model.pi_links.reshape(-1, 10)
    assert pi[7].any() is np.False_  # nothing is left between joint 7 and the sensor
    np.testing.assert_allclose(pi[8], plain.pi_links[-10:], rtol=1e-12)
    q = np.linspace(-1.0, 1.0, 7)
    whole = model.composite(q) @ model.pi_links
    np.testing.assert_allclose(whole, plain.composite(q) @ plain.pi_links, rtol=1e-12)


def test_a_frame_that_no_joint_moves_is_refused():
    with pytest.raises(ConfigError, match=r"wrench_sensors\.0\.frame: 'base' is the root link"):
        RobotModel(URDF, "tool", None, [sensor("base")])
    with pytest.raises(ConfigError, match=r"wrench_sensors\.0\.frame: 'hand' is not a link"):
        RobotModel(URDF, "tool", None, [sensor("hand")])


def test_mrnea_is_refused():
    with pytest.raises(ConfigError, match=r"estimator.method: 'mrnea' has no rows"):
        with_wrist(make_config(method="mrnea"))
