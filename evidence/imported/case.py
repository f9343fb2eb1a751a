"""One seed of an arm on a bench: a table of its samples, imported and identified.

MuJoCo gives torques and wrench. The arm holds a box and either moves or stands in many postures.
`fsw import` and `fsw identify` run as a user runs them.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from hil.world.history import TruthState
from hil.world.inertia import FloatArray
from hil.world.links import load_bodies
from hil.world.robot import BASE_NQ, Robot
from hil.world.scenario import ScenarioError
from hil.world.spline import JointSpline
from hil.world.stand import Stand
from hil.world.truth import simulate
from hil.world.wrench_sensor import wrenches

HIL = Path(__file__).parents[2] / "hil"
URDF, TOOL = HIL / "robots" / "lab_arm.urdf", "tool"
MOTION = HIL / "trajectories" / "bench_identification.yaml"
STAND = Stand(motion="clamped")
RATE_HZ, POSES, REACH_RAD = 200.0, 60, 1.5
NOISE_NM, OFFSET_NM, SCALE_RATIO = 0.05, 0.2, 0.01  # of joints' torques
POSITION_NOISE_RAD = 1e-6
WRIST_NOISE, WRIST_OFFSET = (0.2, 0.01), (2.0, 0.1)  # force [N], moment [N m]
PLACE_M, TURN_RAD = (0.01, -0.02, 0.03), (0.0, 0.0, 0.4)  # of the sensor in the tool frame
PRIOR_KG, PRIOR_KG_SIGMA = 4.0, 3.0
STREAM = 223
MOTIONS = ("moving", "poses")
SENSORS = ("joints", "wrist", "both")  # wrist: the joints measure no torque


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """One run; `changes` are keys of the sensor's section that are declared wrong."""

    motion: str
    sensors: str
    seed: int
    changes: tuple[tuple[str, Any], ...] = field(default=())

    def __str__(self) -> str:
        """Return the key in the store."""
        return f"{self.motion} {self.sensors} {self.seed}"


def work(case: Case) -> dict[str, dict[str, Any]]:
    """Return the row of a case under its key."""
    with tempfile.TemporaryDirectory(prefix="imported-") as name:
        return {str(case): row_of(identified(case, Path(name)))}


def row_of(found: dict[str, Any]) -> dict[str, Any]:
    """Return error, sigma and verdict of the mass, and the NEES of mass and first moments."""
    box = load_bodies(HIL / "robots" / "laboratory_bodies.yaml")["box"]
    mean, P = np.array(found["mean"])[:4], np.array(found["covariance"])[:4, :4]
    error = mean - box.mass_kg * np.array([1.0, *box.com_m])
    return {
        "status": found["status"],
        "mass_error_kg": float(error[0]),
        "mass_sigma_kg": float(np.sqrt(P[0, 0])),
        "nees": float(error @ np.linalg.solve(P, error)),
    }


def identified(case: Case, folder: Path) -> dict[str, Any]:
    """Write, import and identify the table of a case; return the result of `fsw identify`.

    Raises
    ------
    ScenarioError if `fsw import` refuses the table, or `fsw identify` prints no result.
    """
    config, recording = (str(path) for path in imported(case, folder))
    said = _fsw("identify", recording, "--config", config, "--json", may_fail=True)
    return dict(json.loads(said))


def imported(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write and import the table of a case; return its configuration and its recording.

    Raises
    ------
    ScenarioError if `fsw import` refuses the table.
    """
    config, mapping, table, out = (
        folder / name for name in ("robot.yaml", "map.yaml", "arm.csv", "arm.mcap")
    )
    columns = _columns(case)
    np.savetxt(
        table,
        np.column_stack(list(columns.values())),
        "%.12g",
        ",",
        header=",".join(columns),
        comments="",
    )
    config.write_text(yaml.safe_dump(_config(case)), encoding="utf-8")
    mapping.write_text(yaml.safe_dump(_mapping(case)), encoding="utf-8")
    _fsw("import", str(table), "--map", str(mapping), "--config", str(config), "--out", str(out))
    return config, out


def _fsw(*arguments: str, may_fail: bool = False) -> str:
    command = [sys.executable, "-m", "fsw", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode and not (may_fail and done.stdout):
        raise ScenarioError(f"fsw {arguments[0]}: {done.stderr.strip()}")
    return done.stdout


def _columns(case: Case) -> dict[str, FloatArray]:
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(STREAM,)))
    box = load_bodies(HIL / "robots" / "laboratory_bodies.yaml")["box"]
    robot = Robot.load(URDF, TOOL, target=box)
    state = _moving(robot) if case.motion == "moving" else _still(robot, rng)
    k, n = state.q.shape
    scale = 1.0 + SCALE_RATIO * (rng.normal() + rng.normal(size=n)) / np.sqrt(2.0)
    tau = state.tau * scale + rng.normal(scale=OFFSET_NM, size=n)
    tau += rng.normal(scale=NOISE_NM, size=(k, n))
    q = state.q + rng.normal(scale=POSITION_NOISE_RAD, size=(k, n))
    R = Rotation.from_euler("xyz", TURN_RAD).as_matrix()
    wrench = wrenches(robot, state, TOOL, PLACE_M, R, STAND.gravity_m_s2)
    scale = 1.0 + SCALE_RATIO * (rng.normal() + rng.normal(size=6)) / np.sqrt(2.0)
    wrench = wrench * scale + np.repeat(WRIST_OFFSET, 3) * rng.normal(size=6)
    wrench += np.repeat(WRIST_NOISE, 3) * rng.normal(size=(k, 6))
    found = {} if case.motion == "poses" else {"t": state.t_s}
    found |= {f"q_{name}": column for name, column in zip(robot.joint_names, q.T, strict=True)}
    found |= {f"tau_{name}": column for name, column in zip(robot.joint_names, tau.T, strict=True)}
    axes = [f"{part}{axis}" for part in "ft" for axis in "xyz"]
    return found | dict(zip(axes, wrench.T, strict=True))


def _moving(robot: Robot) -> TruthState:
    spline = JointSpline.load(MOTION)
    history = simulate(robot, spline, 0.0, spline.duration_s, stand=STAND)
    return history.at(np.arange(1.0, spline.duration_s * RATE_HZ - 1.0) / RATE_HZ)


def _still(robot: Robot, rng: np.random.Generator) -> TruthState:
    """Return postures at rest; the torques are those that gravity asks for."""
    q = rng.uniform(-REACH_RAD, REACH_RAD, (POSES, robot.n))
    tau, none, vector = np.empty_like(q), np.zeros_like(q), np.zeros((POSES, 3))
    robot.model.opt.gravity[:] = STAND.gravity_m_s2
    data = mujoco.MjData(robot.model)
    for k, posture in enumerate(q):
        data.qpos[3], data.qpos[BASE_NQ:] = 1.0, posture
        mujoco.mj_fwdPosition(robot.model, data)
        mujoco.mj_fwdVelocity(robot.model, data)
        tau[k] = data.qfrc_bias[-robot.n :]
    return TruthState(
        t_s=np.arange(POSES, dtype=np.float64),
        q=q,
        qd=none,
        qdd=none,
        tau=tau,
        p_NB_N=vector,
        v_NB_N=vector,
        R_NB=np.tile(np.eye(3), (POSES, 1, 1)),
        q_NB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (POSES, 1)),
        w_NB_B=vector,
        wd_NB_B=vector,
        a_NB_B=vector,
        g_NB_B=np.tile(STAND.gravity_m_s2, (POSES, 1)),
        gradient_B=np.zeros((POSES, 3, 3)),
    )


def _config(case: Case) -> dict[str, Any]:
    joint: dict[str, Any] = {
        "bus": "arm",
        "speed_limit_rad_s": 3.0,
        "position_noise_rad": POSITION_NOISE_RAD,
        "zero_sigma_rad": 0.0,
        "torque": "none",
    }
    if case.sensors != "wrist":
        joint |= {
            "torque": "link_side",
            "torque_limit_nm": 300.0,
            "torque_noise_nm": NOISE_NM,
            "torque_offset_sigma_nm": OFFSET_NM,
            "torque_scale_sigma_ratio": SCALE_RATIO,
        }
    wrist = {
        "name": "wrist",
        "rate_hz": RATE_HZ,
        "frame": TOOL,
        "p_FS_m": list(PLACE_M),
        "rpy_FS_rad": list(TURN_RAD),
        "force_limit_n": 1000.0,
        "torque_limit_nm": 100.0,
        "force_noise_n": WRIST_NOISE[0],
        "torque_noise_nm": WRIST_NOISE[1],
        "force_offset_sigma_n": WRIST_OFFSET[0],
        "torque_offset_sigma_nm": WRIST_OFFSET[1],
        "scale_sigma_ratio": SCALE_RATIO,
    }
    prior = {
        "mass_kg": PRIOR_KG,
        "com_m": [0.0, 0.0, 0.05],
        "inertia_kg_m2": [0.03, 0.0, 0.0, 0.03, 0.0, 0.03],
        "sigma": {
            "mass_kg": PRIOR_KG_SIGMA,
            "com_m": [0.1, 0.1, 0.1],
            "inertia_kg_m2": [0.03, 0.02, 0.02, 0.03, 0.02, 0.03],
        },
    }
    names = [f"joint{k + 1}" for k in range(7)]
    return {
        "robot": {"urdf": str(URDF), "tool_frame": TOOL, "links_sigma_ratio": 0.0},
        "base": {"motion": STAND.motion, "gravity_B_m_s2": list(STAND.gravity_m_s2)},
        "unknown": ["target"],
        "bodies": {"target": prior},
        "buses": [{"name": "arm", "interface": "samples", "rate_hz": RATE_HZ}],
        "joints": [{"name": name, "node_id": 17 + k} | joint for k, name in enumerate(names)],
        "wrench_sensors": [] if case.sensors == "joints" else [wrist | dict(case.changes)],
        "scheduler": {"tick_rate_hz": RATE_HZ},
        "service": {"state_directory": "state"},
    }


def _mapping(case: Case) -> dict[str, Any]:
    joints: dict[str, Any] = {"position": {"columns": "q_{}", "unit": "rad"}}
    if case.sensors != "wrist":
        joints["torque"] = {"columns": "tau_{}", "unit": "N m"}
    found: dict[str, Any] = {"joints": joints}
    if case.motion == "poses":
        joints["poses"] = True
    else:
        found["time"] = {"column": "t", "unit": "s"}
    if case.sensors != "joints":
        found["wrench_sensors"] = {
            "force": {"columns": "f{}", "unit": "N"},
            "torque": {"columns": "t{}", "unit": "N m"},
        }
    return found
