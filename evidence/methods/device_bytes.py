"""Device level: run plant and daemon in virtual time, then every method on the recorded blocks."""

import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from evidence.methods.cases import DEVICE, WIDER, StudyRecord, scenario_of, truth_of
from evidence.methods.exact import true_robot
from evidence.methods.fisher import ALL
from evidence.methods.flight_side import priors_of, write_config
from evidence.methods.methods import with_estimator
from evidence.methods.sample_level import judge_all
from fsw.config import Config
from fsw.messages import Block
from hil.judge.bound import Sensors, information
from hil.judge.floating import FloatingRobot
from hil.judge.score import BOUND_RATE_HZ
from hil.run.bench import EDGE_S, Setup, run_virtual
from hil.run.flight_sensors import bound_sensors
from hil.run.progress import Quiet
from hil.world.history import TruthHistory
from hil.world.inertia import FloatArray, pi_of
from hil.world.robot import Robot
from hil.world.spline import JointSpline
from hil.world.truth import simulate

SENSORS = "data sheet"  # the sensor set of the scenarios' devices
SILENT = 1e12  # factor on the noise of a channel that is not used


def run_seed(case: str, seed: int, methods: Sequence[str]) -> list[StudyRecord]:
    """Return the results of the methods on the blocks of one run of plant and daemon."""
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        config, blocks = _run(case, seed, Path(folder))
        return judge_all(DEVICE, case, SENSORS, seed, methods, blocks, config)


@lru_cache(maxsize=32)
def native_information(case: str, channels: str) -> FloatArray:
    """Return the Fisher information (p, p) of the raw sensors' samples, biases marginalised.

    The noise is white at native rates; the samples include the rests before and after the motion.
    `channels`: all (every sensor), torque or rda (torque), cm (gyro). The bodies have no prior.
    """
    scenario = scenario_of(case)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    spline, history = _motion(case)
    end_s = spline.duration_s + scenario.after_s
    t_s = np.arange(-scenario.before_s, end_s, 1.0 / BOUND_RATE_HZ)
    state = history.at(np.clip(t_s, history.start_s, history.end_s))
    sensors = _only(bound_sensors(scenario, robot.n), channels)
    motion = (state.q, state.qd, state.qdd)
    return information(robot, sensors, truth_of(case), motion, BOUND_RATE_HZ)


def _only(sensors: Sensors, channels: str) -> Sensors:
    """Return the sensors with a very large noise on the channels that are not used."""
    from dataclasses import replace

    if channels == ALL:
        return sensors
    acc = sensors.acc_noise_m_s2 * SILENT
    if channels == "cm":
        torque = sensors.torque_noise_nm * SILENT
        return replace(sensors, torque_noise_nm=torque, acc_noise_m_s2=acc)
    gyro = sensors.gyro_noise_rad_s * SILENT
    return replace(sensors, gyro_noise_rad_s=gyro, acc_noise_m_s2=acc)


def _run(case: str, seed: int, folder: Path) -> tuple[Config, Sequence[Block]]:
    """Run plant and daemon; return configuration and blocks. All seeds have the same true motion.

    The online estimator of the daemon does not change the blocks, so the cheapest one runs.
    """
    scenario = scenario_of(case)
    spline, history = _motion(case)
    config = write_config(scenario, seed, folder, WIDER)
    setup = Setup(
        scenario=scenario,
        seed=seed,
        folder=folder,
        config_path=folder / "flight.yaml",
        config=with_estimator(config, "mrnea", "ols"),
        priors=priors_of(scenario, seed, WIDER),
        robot=_robot(case),
        spline=spline,
        history=history,
        bus_ports=scenario.bus_ports,
    )
    recorded = run_virtual(setup, Quiet(), record=False)
    return config, recorded.blocks


@lru_cache(maxsize=3)
def _robot(case: str) -> Robot:
    return true_robot(scenario_of(case))


@lru_cache(maxsize=3)
def _motion(case: str) -> tuple[JointSpline, TruthHistory]:
    spline = JointSpline.load(scenario_of(case).identification)
    return spline, simulate(_robot(case), spline, -EDGE_S, spline.duration_s + EDGE_S)
