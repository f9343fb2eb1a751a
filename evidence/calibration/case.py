"""One seed of a calibration: simulate wrong sensors, run `fsw calibrate`, judge its figures.

The simulated devices draw offsets, scales and biases. The seed also draws errors of mounting, lever
arm and delays in the flight configuration. At rest the biases also follow a random walk.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from evidence.store import Row
from hil.run.bench import VirtualRun, prepare
from hil.run.processes import tied
from hil.run.progress import Quiet
from hil.world.scenario import Scenario, at_rates, changed, load
from hil.world.sensor_config import SensorConfig
from hil.world.sensors import ImuErrors, JointErrors

BOUND_SIGMAS = 3.0  # largest allowed distance of a figure from the truth, in the figure's sigma
KINDS = (  # scenario and mode; table_target at rest is left out: it is like bench_target
    ("target_leo", "rest"),
    ("target_leo", "motion"),
    ("table_target", "motion"),
    ("bench_target", "rest"),
    ("bench_target", "motion"),
)
STREAM = 131  # spawn key of the configuration's errors
RATE_HZ, IMU_RATE_HZ = 100.0, 125
REST_S, MOTION_S = 40.0, 20.0  # durations; the scenario's own rest precedes a motion
PLACE_M, ANGLE_RAD, DELAY_S, TRACKER_S = 0.03, 0.02, 3e-3, 0.02  # 1 sigma of configured errors
SCALE_RATIO = 0.02  # 1 sigma of the torque scales
LAG_S = 0.3  # longer than any wrong delay of a star tracker
SETTINGS = {
    "rest": (
        f"timing.before_s={REST_S}",
        "sensors.imu.gyro_bias_walk_rad_s_sqrt_s=1.0e-6",
        "sensors.imu.acc_bias_walk_m_s2_sqrt_s=1.0e-5",
    ),
    "motion": (f"sensors.joints.torque_scale_error_ratio={SCALE_RATIO}",),
}


@dataclass(frozen=True, slots=True)
class Case:
    """One recording and its calibration."""

    scenario: str
    mode: str
    seed: int

    def __str__(self) -> str:
        return f"{self.scenario} {self.mode} {self.seed}"


def work(case: Case) -> dict[str, Row]:
    """Return a case's figures under its name, each with its true value and its error in sigmas.

    Raises
    ------
    RuntimeError if `fsw calibrate` ends without figures.
    """
    scenario = at_rates(load(case.scenario), RATE_HZ, IMU_RATE_HZ)
    scenario = changed(scenario, SETTINGS[case.mode])
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        folder = Path(name)
        setup = prepare(scenario, case.seed, folder, overrides={"lag_s": LAG_S})
        run = VirtualRun(setup, record=True)
        seconds = REST_S if case.mode == "rest" else scenario.before_s + MOTION_S
        run.advance(seconds, Quiet())
        run.finish(Quiet())
        config = setup.config_path.read_text(encoding="utf-8")
        wrong, errors = configured_errors(scenario, case.seed, yaml.safe_load(config))
        (folder / "wrong.yaml").write_text(yaml.safe_dump(wrong), encoding="utf-8")
        command = [sys.executable, "-m", "fsw", "calibrate", case.mode, "recording.mcap"]
        command += ["--config", setup.config_path.name, "--overlay", "wrong.yaml", "--json"]
        done = subprocess.run(
            tied(command), cwd=folder, capture_output=True, text=True, check=False
        )
    if not done.stdout.strip():
        raise RuntimeError(f"{case} failed: {done.stderr.strip()[-500:]}")
    late = {f"torque_delay.{name}": 0.0 for name in setup.robot.joint_names}  # of none
    truth = drawn_errors(scenario, case.seed, setup.robot.joint_names) | errors | late
    figures = json.loads(done.stdout)["figures"]
    return {str(case): {"figures": [judged(figure, truth) for figure in figures]}}


def judged(figure: Mapping[str, Any], truth: Mapping[str, float]) -> dict[str, Any]:
    """Return a figure with the true value and the figure's error in units of its sigma."""
    off = (figure["value"] - truth[figure["name"]]) / figure["sigma"]
    return {**figure, "truth": truth[figure["name"]], "off_sigmas": off}


def configured_errors(
    scenario: Scenario, seed: int, config: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, float]]:
    """Return an overlay of wrong values, and true minus wrong values by the figures' names."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    imu, mounting = config["imu"], config["imu"]["mounting"]
    place, angle = PLACE_M * rng.standard_normal(3), ANGLE_RAD * rng.standard_normal(3)
    turned = Rotation.from_rotvec(angle).inv() * Rotation.from_quat(mounting["q_BS_xyzw"])
    delays = {"gyro": imu["gyro_group_delay_s"], "accelerometer": imu["acc_group_delay_s"]}
    told = {k: max(0.0, true - DELAY_S * rng.standard_normal()) for k, true in delays.items()}
    delays["star_tracker"] = config["star_tracker"]["latency_s"]
    told["star_tracker"] = delays["star_tracker"] - TRACKER_S * float(rng.standard_normal())
    scale_sigma = SCALE_RATIO if "torque_scale_error_ratio" in scenario.sensors["joints"] else 0.0
    overlay = {
        "joints": [
            {"name": joint["name"], "torque_scale_sigma_ratio": scale_sigma}
            for joint in config["joints"]
        ],
        "imu": {
            "mounting": {
                "p_BS_m": (np.array(mounting["p_BS_m"]) - place).tolist(),
                "q_BS_xyzw": turned.as_quat().tolist(),
            },
            "mounting_position_sigma_m": PLACE_M,
            "mounting_angle_sigma_rad": ANGLE_RAD,
            "gyro_group_delay_s": float(told["gyro"]),
            "acc_group_delay_s": float(told["accelerometer"]),
        },
        "star_tracker": {"latency_s": told["star_tracker"]},
    }
    errors = {f"delay.{name}": float(delays[name] - told[name]) for name in delays}
    for axis, p, phi in zip("xyz", place.tolist(), angle.tolist(), strict=True):
        errors |= {f"imu_place.{axis}": p, f"imu_angle.{axis}": phi}
    return overlay, errors


def drawn_errors(scenario: Scenario, seed: int, joints: tuple[str, ...]) -> dict[str, float]:
    """Return the errors that the devices draw [N m, 1, rad/s, m/s2], by the figures' names."""
    sensors = SensorConfig.from_dict(scenario.sensors)
    if sensors.imu is None:
        raise ValueError(f"{scenario.name}: no inertial unit to calibrate")
    own, imu = JointErrors(sensors.joints, len(joints), seed), ImuErrors(sensors.imu, seed)
    found = {}
    for k, name in enumerate(joints):
        found[f"torque_offset.{name}"] = float(own.torque_offset_nm[k])
        found[f"torque_scale.{name}"] = float(own.torque_scale[k]) - 1.0
    for k, axis in enumerate("xyz"):
        found[f"gyro_bias.{axis}"] = float(imu.gyro_bias_rad_s[k])
        found[f"acc_bias.{axis}"] = float(imu.acc_bias_m_s2[k])
    return found
