"""The CasADi functions against Pinocchio's, as the estimator uses them."""

from dataclasses import replace

import numpy as np
import pytest

from evidence.excitation import cases
from fsw.config import Config
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.inertia import PARAMETERS
from fsw.messages import Block
from planner.kernel import build_kernel
from planner.subject import build_subject
from tests.support.estimator_cases import TWO_ARMS
from tests.support.excitation_cases import SYSTEMS, subject
from tests.support.one_block import fused_rows
from tests.support.sliding import sliding_config

NODES = 4
HALF_S = 0.2


def block_of(own, q, qd, qdd):
    """Return a block of exact motion; the covariances are those of full windows."""
    from fsw.estimators.conditioning.polynomial import NodeFit

    m, n = q.shape
    t_s = (np.arange(200) + 0.5) / 500 - HALF_S
    low, high = NodeFit(t_s, HALF_S, m - 1, m), NodeFit(t_s, HALF_S, m + 2, m)
    joint = own.config.joints[0]
    imu = own.config.imu
    zero = np.zeros((m, 3))
    return Block(
        index=0,
        t_ns=np.arange(m, dtype=np.int64),
        q_rad=q,
        qd_rad_s=qd,
        qdd_rad_s2=qdd,
        tau_nm=np.zeros((m, n)),
        w_NB_B_rad_s=zero,
        wd_NB_B_rad_s2=zero,
        f_NS_B_m_s2=zero,
        R_NB=np.broadcast_to(np.eye(3), (m, 3, 3)).copy(),
        cov_joint=np.stack([high.covariance((1, 2), joint.position_noise_rad)] * n),
        cov_tau=np.stack([low.covariance((0,), joint.torque_noise_nm)] * n),
        cov_gyro=low.covariance((0, 1), imu.angle_random_walk_rad_sqrt_s * 500**0.5),
        cov_acc=low.covariance((0,), imu.velocity_random_walk_m_s_sqrt_s * 500**0.5),
        has_joint=np.ones(n, dtype=bool),
        has_gyro=True,
        has_accelerometer=True,
        has_attitude=True,
    )


def two_armed(system):
    """Return the subject of a system whose base carries a second arm."""
    known = cases.config(system).model_dump(mode="json")
    joint = known["joints"][0]
    known["robot"] |= {"urdf": str(TWO_ARMS), "tool_frame": "left_tool"}
    known["joints"] = [
        joint | {"name": f"{side}_joint{k + 1}", "node_id": first + k}
        for side, first in (("left", 0x11), ("right", 0x21))
        for k in range(7)
    ]
    return build_subject(Config.model_validate(known))


def random_motion(seed=3, n=7):
    rng = np.random.default_rng(seed)
    return (scale * rng.standard_normal((NODES, n)) for scale in (0.8, 0.15, 0.08))


@pytest.mark.parametrize(
    ("system", "arms"), [*((system, 1) for system in SYSTEMS), ("both", 2), ("target", 2)]
)
def test_predictions_and_their_jacobians_are_the_estimators(system, arms):
    own = subject(system) if arms == 1 else two_armed(system)
    q, qd, qdd = random_motion(n=7 * arms)
    state = own.problem.prior_mean.copy()
    expected = predict(block_of(own, q, qd, qdd), state, own.problem)
    k = len(own.x)
    for i in range(NODES):
        y, J = own.kernel.predictions(q[i], qd[i], qdd[i], own.x)
        values = np.concatenate([expected.tau_nm[i], expected.f_m_s2[i], expected.w_rad_s[i]])
        jacobian = np.vstack([expected.J_tau[i], expected.J_f[i], expected.J_w[i]])[:, :k]
        np.testing.assert_allclose(y.full().ravel(), values, rtol=0, atol=1e-9)
        np.testing.assert_allclose(J.full(), jacobian, rtol=1e-9, atol=1e-9)


def test_predictions_of_a_robot_that_slides_are_the_estimators(tmp_path):
    own = build_subject(sliding_config(tmp_path, ("target",)))
    q, qd, qdd = random_motion()
    expected = predict(block_of(own, q, qd, qdd), own.problem.prior_mean, own.problem)
    for i in range(NODES):
        y, J = own.kernel.predictions(q[i], qd[i], qdd[i], own.x)
        values = np.concatenate([expected.tau_nm[i], expected.f_m_s2[i], expected.w_rad_s[i]])
        jacobian = np.vstack([expected.J_tau[i], expected.J_f[i], expected.J_w[i]])[:, :10]
        np.testing.assert_allclose(y.full().ravel(), values, rtol=0, atol=1e-9)
        np.testing.assert_allclose(J.full(), jacobian, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("system", SYSTEMS)
def test_information_of_a_steady_window_is_the_estimators(system):
    # at one repeated state the Jacobian does not change in the window; the motion is exact
    own = subject(system)
    q, qd, qdd = (np.repeat(x[:1], NODES, axis=0) for x in random_motion())
    block = block_of(own, q, qd, qdd)
    block = replace(block, cov_joint=0.0 * block.cov_joint)
    rows = fused_rows(block, own.problem.prior_mean, own.problem).A
    X = np.sqrt(2 * HALF_S) * own.kernel.information(q[0], qd[0], qdd[0], own.x).full()
    expected, found = rows.T @ rows, X.T @ X
    scale = np.sqrt(np.diag(expected))
    difference = (found - expected) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-3


def test_torque_scale_and_momentum_are_nuisances_of_the_estimators_rows():
    own = subject("both")
    noise = replace(own.noise, torque_scale=True, momentum=True)
    known = np.zeros(PARAMETERS)
    kernel = build_kernel(own.arm, own.problem.unknown, known, None, noise)
    assert kernel.states == own.kernel.states + 3 + 7
    q, qd, qdd = random_motion()
    X = kernel.information(q[0], qd[0], qdd[0], own.x).full()
    tau = kernel.motion(q[0], qd[0], qdd[0], own.x).full()[:7, 0]
    offsets = X[:, len(own.x) : len(own.x) + 7]
    np.testing.assert_allclose(X[:, -7:], offsets * tau, rtol=1e-9, atol=1e-9)
    # momentum: the base turns as a rigid body of the whole's inertia, gyro rows alone are checked
    rate = X[-3:, len(own.x) + 13 : len(own.x) + 16]
    assert np.all(np.linalg.eigvals(rate).real > 0)


def test_limits_quantities_are_those_of_the_prediction():
    own = subject("both")
    q, qd, qdd = random_motion()
    g = own.kernel.motion(q[1], qd[1], qdd[1], own.x).full().ravel()
    expected = predict(block_of(own, q, qd, qdd), own.problem.prior_mean, own.problem)
    np.testing.assert_allclose(g[:7], expected.tau_nm[1], atol=1e-9)
    np.testing.assert_allclose(g[7:10], expected.w_rad_s[1], atol=1e-9)
