"""Thrusters from truth to estimate: MuJoCo's motion, masses at rest, what is missed or left out."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.conditioning.blocks import build_conditioner
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.prediction import Prediction
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import report_jacobian
from fsw.messages import Block, Window
from hil.judge import judgement
from hil.run import bench
from hil.world.history import TruthHistory
from hil.world.robot import Robot
from hil.world.scenario import Scenario, load
from hil.world.spline import JointSpline
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    RATE_HZ,
    SENSOR_B_M,
    TARGET,
    URDF,
    WINDOW_S,
    channel,
    make_config,
    parameters,
    robot_model,
    wrong,
)
from tests.support.short_cases import IMU_RATE_HZ, NoMeter
from tests.support.thruster_cases import STAR_TRACKER

CHI2_20_999 = 45.3  # 99.9 % bound of chi-squared with 20 degrees of freedom
SCENARIO = load("mev")
SYSTEM = SCENARIO.thrusters
assert SYSTEM is not None
LENGTH_S = 16.0


@lru_cache(maxsize=1)
def flight() -> TruthHistory:
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET, thrusters=SYSTEM)
    return simulate(robot, JointSpline.load(SCENARIO.identification), 0.0, LENGTH_S, 0.002)


def config(**options: Any) -> Config:
    assert SYSTEM is not None
    data = make_config(("base", "target"), biases=False, **options).model_dump()
    data["star_tracker"] = STAR_TRACKER
    data["thrusters"] = [
        {
            "name": f"thruster{k + 1}",
            "bus": "arm",
            "node_id": 0x31,
            "valve": k,
            "rate_hz": 50.0,
            "p_B_m": jet.place_m,
            "direction_B": jet.unit.tolist(),
            "force_n": jet.force_n,
            "force_sigma_ratio": 0.0,
            "delay_s": SYSTEM.delay_s,
            "rise_s": SYSTEM.rise_s,
        }
        for k, jet in enumerate(SYSTEM.jets)
    ]
    return Config.model_validate(data)


def window(index: int) -> Window:
    """Noise-free samples of every channel; a valve is reported each 20 ms and at its changes."""
    assert SYSTEM is not None
    start_s, count = index * WINDOW_S, round(WINDOW_S * RATE_HZ)
    t = start_s + (np.arange(count) + 0.5) / RATE_HZ
    s, r = flight().at(t), np.array(SENSOR_B_M)
    f = s.a_NB_B + np.cross(s.wd_NB_B, r) + np.cross(s.w_NB_B, np.cross(s.w_NB_B, r))
    valves = []
    for k in range(len(SYSTEM.jets)):
        own = [p for p in SYSTEM.pulses if p.jet == k]
        changes = [e for p in own for e in ((p.on_s, 1.0), (p.on_s + p.for_s, 0.0))]
        rows = [(x, y, 1.0) for x, y in changes if 0.0 <= x - start_s + 1e-9 < WINDOW_S]
        reports = start_s + 0.02 * (np.arange(20) + 0.5)
        rows += [(x, float(SYSTEM.valves_at(x)[0][k]), 0.0) for x in reports.tolist()]
        values = np.array(sorted(rows, key=lambda row: (row[0], -row[2])))  # as sources order them
        valves.append(channel(values[:, 0], values[:, 1:]))
    turn = s.q_NB_xyzw
    return Window(
        index=index,
        start_ns=round(start_s * 1e9),
        stop_ns=round((start_s + WINDOW_S) * 1e9),
        joints=tuple(channel(t, np.stack([s.q[:, j], s.tau[:, j]], axis=1)) for j in range(7)),
        gyro=channel(t, s.w_NB_B),
        accelerometer=channel(t, f),
        attitude=channel(t, turn),
        devices={"thrusters": tuple(valves)},
    )


@lru_cache(maxsize=1)
def blocks() -> tuple[Block, ...]:
    conditioner = build_conditioner(config(), robot_model())
    found = [conditioner.condition(window(k)) for k in range(int(LENGTH_S / WINDOW_S) - 1)]
    assert conditioner.outliers == 0
    return tuple(block for block in found if block is not None)


def test_another_engine_s_firings_leave_no_residual() -> None:
    """MuJoCo's torques, forces and rates, sampled and projected, are those predicted."""
    problem = build_problem(config(), robot_model())
    x = problem.prior_mean.copy()
    x[problem.body("base")], x[problem.body("target")] = parameters(BASE), parameters(TARGET)
    before: Impulse | None = None
    worst, size = np.zeros(3), np.zeros(3)
    for block in blocks():
        p: Prediction = predict(BlockStack((block,)), x, problem, "momentum", before)
        before = p.after
        pairs = (
            (p.tau_nm, block.tau_nm),
            (p.f_m_s2, block.f_NS_B_m_s2),
            (p.w_rad_s, block.w_NB_B_rad_s),
        )
        worst = np.maximum(worst, [np.abs(a - b).max() for a, b in pairs])
        size = np.maximum(size, [np.abs(b).max() for _, b in pairs])
    assert len(blocks()) > 35
    # what sampling at 500 Hz leaves of a rise in 20 ms: under a tenth of a sample's noise
    assert (worst < [5e-3, 2e-5, 2e-5]).all(), worst
    assert (size > [5.0, 0.01, 3e-3]).all(), size


def pull_of_the_prior(prior: Config, covariance: np.ndarray) -> np.ndarray:
    """Return by how much the wrong prior moves the estimate of data that say the truth.

    The covariance times the slope of the prior's density there: a Gaussian of mass, centre of mass
    and central inertia.
    """
    slope = np.zeros(len(covariance))
    for k, (name, body) in enumerate((("base", BASE), ("target", TARGET))):
        stated = prior.bodies[name]
        assert stated.sigma is not None
        off, weight = [], []
        for field in ("mass_kg", "com_m", "inertia_kg_m2"):
            off += np.atleast_1d(np.subtract(getattr(stated, field), getattr(body, field))).tolist()
            weight += np.atleast_1d(getattr(stated.sigma, field)).tolist()
        J = report_jacobian(parameters(body))
        slope[10 * k : 10 * k + 10] = J.T @ (np.array(off) / np.square(weight))
    return covariance @ slope


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_noise_free_firings_give_both_bodies_back(method: str) -> None:
    rng = np.random.default_rng(5)
    prior = config(base=wrong(BASE, rng), target=wrong(TARGET, rng))
    found = run_batch(prior, list(blocks()), method, ("base", "target"))
    pull = pull_of_the_prior(prior, np.array(found["covariance"]))
    for name, body in (("base", BASE), ("target", TARGET)):
        k = found["names"].index(f"{name}.m")
        sigma_kg = np.sqrt(found["covariance"][k][k])
        error_kg = found["mean"][k] - body.mass_kg
        assert abs(error_kg - pull[k]) < 2e-3 * body.mass_kg + 0.1 * sigma_kg
        assert sigma_kg < 0.1 * body.mass_kg


def short(folder: Path, **changes: Any) -> Scenario:
    motion = JointSpline.load(SCENARIO.identification)
    JointSpline(14.0, motion.control_points_rad[:12]).save(folder / "motion.yaml")
    bus = SCENARIO.flight["bus"] | {"rate_hz": 200.0}
    return replace(
        SCENARIO,
        identification=folder / "motion.yaml",
        before_s=1.0,
        after_s=0.5,
        sensors=SCENARIO.sensors | {"imu": SCENARIO.sensors["imu"] | {"rate_hz": IMU_RATE_HZ}},
        flight=SCENARIO.flight | {"bus": bus, "tick_rate_hz": 200.0},
        **changes,
    )


def judged(folder: Path, scenario: Scenario, **sections: Any) -> tuple[dict[str, Any], Any]:
    setup = bench.prepare(scenario, 1, folder)
    if sections:
        setup = replace(setup, config=setup.config.with_sections(**sections))
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded), recorded


def test_a_docked_stack_is_weighed_while_the_arm_rests(tmp_path: Path) -> None:
    outcome, recorded = judged(tmp_path, short(tmp_path))
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_20_999
    base, target = outcome["sigma"]["base"]["mass_kg"], outcome["sigma"]["target"]["mass_kg"]
    assert 0.5 * 0.03 * 1000.0 < base < 2.0 * 0.03 * 1400.0  # the force's prior limits it
    assert target < 0.01 * 400.0
    assert recorded.status["thrusters"]["thruster1"]["rejected"] == 0
    assert recorded.status["windows"]["unusable"] <= 1


def test_thrusters_left_out_of_the_configuration_are_never_confidently_wrong(
    tmp_path: Path,
) -> None:
    outcome, _ = judged(tmp_path, short(tmp_path), thrusters=())
    assert not outcome["valid"] or outcome["nees"] < CHI2_20_999
