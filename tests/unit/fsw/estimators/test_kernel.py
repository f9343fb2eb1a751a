"""The compiled dynamics against Pinocchio and the Pinocchio-based prediction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsw.estimators import kernel, projection
from fsw.estimators.methods.layout import Columns, Data
from fsw.estimators.methods.least_squares_pass import least_squares_gram
from fsw.estimators.model.robot import RobotModel
from tests.conftest import arm_urdf
from tests.support.estimator_cases import BASE, TARGET, URDF, parameters

BOUND = 1e-9  # relative to the largest entry: rounding of a different order of operations


@pytest.fixture(params=["paper", "three joints"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> RobotModel:
    if request.param == "paper":
        return RobotModel(URDF, "tool")
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(3))
    return RobotModel(path, "gripper")


class Case:
    """One random state, evaluated by both."""

    def __init__(self, model: RobotModel, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.n = n = model.n
        self.pi = model.total_parameters(parameters(BASE), parameters(TARGET))
        self.q, self.qd, self.qdd = rng.normal(size=(3, n))
        self.w, self.a = rng.normal(size=3), rng.normal(size=6)
        arm, change = kernel.build_arm(model)
        bodies = np.einsum("bij,bj->bi", change, self.pi.reshape(-1, 10))
        self.work = kernel.new_work(n)
        self.tau = np.zeros(n)
        kernel.configure(arm, bodies, self.q, self.work)
        kernel.joint_inertia(self.work)
        kernel.accelerate(self.w, self.qd, self.a, self.qdd, self.work)
        kernel.balance(self.work, self.tau)
        kernel.rate_gradient(self.work)
        model.set_parameters(self.pi)
        self.H = model.mass_matrix(self.q)
        self.full = np.concatenate([self.a, self.qdd])
        self.Y = model.regressor(self.q, self.w, self.qd, self.full).copy()


def close(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.abs(a - b).max() <= BOUND * max(1.0, np.abs(b).max()))


@pytest.mark.parametrize("seed", range(5))
def test_mass_matrix_and_its_base_factor_agree_with_pinocchio(model, seed):
    case = Case(model, seed)
    assert close(case.work.H_bm, case.H[:6, 6:].T)
    assert close(case.work.H_m, case.H[6:, 6:])
    assert close(case.work.N, -np.linalg.solve(case.H[:6, :6], case.H[:6, 6:]).T)


@pytest.mark.parametrize("seed", range(5))
def test_forces_agree_with_the_regressor(model, seed):
    case = Case(model, seed)
    force = case.Y @ case.pi
    assert close(case.tau, force[6:])
    assert close(case.work.force[0], force[:6])


@pytest.mark.parametrize("seed", range(5))
def test_rate_gradient_agrees_with_pinocchio(model, seed):
    case = Case(model, seed)
    C = model.bias_derivative(case.q, case.w, case.qd, case.full)[:, 3:6]
    assert close(case.work.C, C)


@pytest.mark.parametrize("seed", range(5))
def test_projections_are_rows_of_the_regressor(model, seed):
    case = Case(model, seed)
    projection.observe_motion(case.work, False)
    row = np.zeros(10)
    for i in range(6 + case.n):
        u = np.eye(6)[i] if i < 6 else case.work.S[i - 6]
        projection.project_tool(case.work, u, np.zeros(6), row)
        assert close(row, case.Y[i, -10:] @ model.tool_map)
        if i < 6:
            projection.project_base(case.work, u, row)
            assert close(row, case.Y[i, :10])


@pytest.mark.parametrize("seed", range(5))
def test_momentum_projections_are_rows_of_the_momentum_regressor(model, seed):
    case = Case(model, seed)
    nu = np.random.default_rng(seed).normal(size=6 + case.n)
    kernel.accelerate(nu[3:6], nu[6:], np.zeros(6), np.zeros(case.n), case.work)
    case.work.V[:, :3] += nu[:3]
    projection.observe_motion(case.work, True)
    Y = model.momentum_regressor(case.q, nu)
    row = np.zeros(10)
    for i in range(6):
        projection.project_tool(case.work, np.eye(6)[i], np.zeros(6), row)
        assert close(row, Y[i, -10:] @ model.tool_map)
        projection.project_base(case.work, np.eye(6)[i], row)
        assert close(row, Y[i, :10])


@pytest.mark.parametrize("unknown", ["base", "target", "both"])
@pytest.mark.parametrize("count", [1, 64, 70])  # less than a chunk, one chunk, and a rest
def test_least_squares_gram_is_that_of_the_regressor(model, unknown, count):
    cases = [Case(model, seed) for seed in range(count)]
    tau = np.random.default_rng(7).normal(size=(count, model.n))
    pieces = []
    for case, own in zip(cases, tau, strict=True):
        columns = []
        if unknown != "target":
            columns.append(case.Y[:, :10])
        if unknown != "base":
            columns.append(case.Y[:, -10:] @ model.tool_map)
        r = np.concatenate([np.zeros(6), own]) - case.Y @ case.pi
        pieces.append(np.column_stack([*columns, r]))
    rows = np.concatenate(pieces)
    arm, change = kernel.build_arm(model)
    bodies = np.einsum("bij,bj->bi", change, cases[0].pi.reshape(-1, 10))
    place = {"base": (0, -1), "target": (-1, 0), "both": (0, 10)}[unknown]
    at = Columns(*place, -1, -1, -1, -1, -1, -1)
    none = np.zeros((count, 3))
    data = Data(
        t=np.arange(float(count)),
        q=np.array([c.q for c in cases]),
        qd=np.array([c.qd for c in cases]),
        qdd=np.array([c.qdd for c in cases]),
        tau=tau,
        w=np.array([c.w for c in cases]),
        wd=np.array([c.a[3:] for c in cases]),
        a=np.array([c.a[:3] for c in cases]),
        v=none,
        R=np.zeros((count, 3, 3)),
        field=np.zeros((0, 3)),
        s_tau=np.ones(model.n),
        s_qdd=np.zeros(model.n),
        s_w=np.zeros(3),
        s_wd=np.zeros(3),
        s_a=np.zeros(3),
        s_v=np.zeros(3),
    )
    G = least_squares_gram(arm, bodies, at, data)
    wanted = rows.T @ rows
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs(G - wanted).max() <= BOUND * np.abs(wanted).max()
    assert np.all(np.abs(G - wanted) <= BOUND * scale + 1e-12)
