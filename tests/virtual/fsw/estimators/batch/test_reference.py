"""A reference without the target tells arm and friction: half the error of the plain batch."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.config.robot import BodySigma
from fsw.estimators.batch.run import run_batch
from fsw.messages import Block, FloatArray
from fsw.messages.errors import EstimatorError
from hil.evidence.methods.cases import NODES, RATE_HZ, SENSOR_SETS, WINDOW_S, scenario_of, truth_of
from hil.evidence.methods.flight_side import write_config
from hil.evidence.methods.sensed import condition, declared, draws, sensed, with_noise
from hil.world.friction import JointFriction, draw_friction
from hil.world.history import TruthState
from hil.world.robot import Body, Robot
from hil.world.spline import JointSpline
from hil.world.truth import simulate

SEEDS = range(int(os.environ.get("REFERENCE_SEEDS", "3")))
SAMPLES = 2400  # 24 s of the motion
FRICTION = {"friction_coulomb_sigma_nm": 0.3, "friction_viscous_sigma_nms_rad": 0.5}
LINKS_SIGMA = 0.05
SENSORS = SENSOR_SETS["data sheet"]


@lru_cache(maxsize=2)
def motion(*, loaded: bool) -> TruthState:
    """Return the same motion of the arm, with and without the target."""
    scenario = scenario_of("target")
    bodies = {name: body_of(report) for name, report in scenario.truth.items()}
    target = bodies["target"] if loaded else None
    robot = Robot.load(scenario.urdf, scenario.tool_frame, bodies["base"], target)
    times = np.arange(SAMPLES) / RATE_HZ
    spline = JointSpline.load(scenario.identification)
    return simulate(robot, spline, 0.0, times[-1] + 0.1, 0.5 / RATE_HZ).at(times)


def body_of(report: FloatArray) -> Body:
    mass, cx, cy, cz, *inertia = (float(value) for value in report)
    xx, xy, xz, yy, yz, zz = inertia
    return Body(mass, (cx, cy, cz), (xx, xy, xz, yy, yz, zz))


def uncertain(right: Config, folder: Path, rng: np.random.Generator) -> Config:
    """Return the configuration with every link's mass and inertia off, and sigmas that say so."""
    path = right.resolve(right.robot.urdf)
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    children = {child.get("link") for child in root.iter("child")}
    for link in root.iter("link"):
        factor = 1.0 + LINKS_SIGMA * rng.standard_normal()
        if link.get("name") in children:
            for element in (*link.iter("mass"), *link.iter("inertia")):
                for key, value in element.attrib.items():
                    element.set(key, repr(factor * float(value)))
    wrong = folder / "wrong.urdf"
    wrong.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    joints = [joint.model_copy(update=FRICTION) for joint in right.joints]
    robot = right.robot.model_copy(update={"urdf": wrong, "links_sigma_ratio": LINKS_SIGMA})
    base = right.bodies["base"]  # weighed before the flight
    weighed = BodySigma(mass_kg=1e-4 * base.mass_kg, com_m=(1e-5,) * 3, inertia_kg_m2=(1e-2,) * 6)
    bodies = {**right.bodies, "base": base.model_copy(update={"sigma": weighed})}
    config = right.model_copy(update={"joints": joints, "robot": robot, "bodies": bodies})
    return declared(config, SENSORS, RATE_HZ, window_s=WINDOW_S, nodes=NODES)


def recorded(
    right: Config,
    config: Config,
    friction: JointFriction,
    rng: np.random.Generator,
    *,
    loaded: bool,
) -> list[Block]:
    """Return the blocks of one run with noise and biases of its own."""
    state = motion(loaded=loaded)
    n = state.q.shape[1]
    noisy = with_noise(sensed(state, right), SENSORS, draws(SAMPLES, n, rng, shared=False))
    offsets = np.array([joint.torque_offset_sigma_nm for joint in right.joints])
    return condition(
        replace(
            noisy,
            tau_nm=noisy.tau_nm + friction.torque_nm(state.qd) + offsets * rng.standard_normal(n),
            w_NS_S_rad_s=noisy.w_NS_S_rad_s
            + right.imu.gyro_bias_sigma_rad_s * rng.standard_normal(3),
            f_NS_S_m_s2=noisy.f_NS_S_m_s2 + right.imu.acc_bias_sigma_m_s2 * rng.standard_normal(3),
        ),
        config,
        RATE_HZ,
    )


def case(seed: int, folder: Path) -> tuple[Config, list[Block], list[Block]]:
    """Return configuration, blocks with the target, and blocks without."""
    rng = np.random.default_rng(3000 + seed)
    right = write_config(scenario_of("target"), seed, folder)
    config = uncertain(right, folder, rng)
    friction = draw_friction(
        rng, len(right.joints), coulomb_sigma_nm=0.3, viscous_sigma_nms_rad=0.5
    )
    loaded, empty = (recorded(right, config, friction, rng, loaded=k) for k in (True, False))
    return config, loaded, empty


def test_a_reference_halves_the_error_of_the_mass_and_stays_honest(tmp_path: Path) -> None:
    truth, squares, nees = truth_of("target"), np.zeros(2), np.zeros(2)
    for seed in SEEDS:
        config, loaded, empty = case(seed, tmp_path)
        for k, reference in enumerate(((), empty)):
            found = run_batch(config, loaded, "fused", (), reference=reference)
            assert found["status"] == "OK", found["note"]
            error, P = np.array(found["mean"])[:10] - truth, np.array(found["covariance"])[:10, :10]
            squares[k] += error[0] ** 2
            nees[k] += error @ np.linalg.solve(P, error)
    figures = np.sqrt(squares[1] / squares[0]), *(nees / len(SEEDS))
    sys.stdout.write(
        "error of the mass with over without {:.3f}, NEES {:.2f} and {:.2f}\n".format(*figures)
    )
    assert np.sqrt(squares[1] / squares[0]) < 0.5, squares
    assert np.all(nees < chi2.ppf(0.999, 10 * len(SEEDS))), nees
    assert np.all(nees > chi2.ppf(0.001, 10 * len(SEEDS))), nees


def test_a_reference_with_the_target_in_it_is_refused(tmp_path: Path) -> None:
    config, loaded, _ = case(0, tmp_path)
    with pytest.raises(EstimatorError, match="reference"):
        run_batch(config, loaded, "fused", (), reference=loaded)


def test_a_regression_takes_no_reference(tmp_path: Path) -> None:
    config, loaded, empty = case(0, tmp_path)
    with pytest.raises(EstimatorError, match="takes arm and calibration as exact"):
        run_batch(config, loaded[:10], "ce", (), reference=empty[:10])
