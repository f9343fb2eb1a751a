"""The paper's robot and limits, for the planner and for the simulated truth."""

from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from hil.world.links import Body, load_bodies
from hil.world.robot import Robot
from hil.world.spline import JointSpline
from planner import limits as flight_limits
from planner.plan import Planner
from planner.request import MotionRequest
from planner.spline import Trajectory
from planner.subject import Subject, build_subject

ROBOTS = Path(__file__).parents[2] / "hil" / "robots"
URDF = ROBOTS / "lbr3_satellite.urdf"
LIMITS = ROBOTS / "lbr3_limits.yaml"
JOINTS = 7
RATE_HZ = 500.0
TORQUE_NOISE_NM = 0.05
TORQUE_OFFSET_SIGMA_NM = 0.1
POSITION_NOISE_RAD = 1.1e-7  # of a 24 bit encoder and the coding on the bus
RATE_NOISE = 4.4e-5  # rad/sqrt(s)
FORCE_NOISE = 5e-4  # m/s/sqrt(s)
GYRO_BIAS_SIGMA_RAD_S = 2e-5
ACC_BIAS_SIGMA_M_S2 = 9.8e-3
SENSOR_B_M = (-0.30, 0.20, -0.45)
SYSTEMS: dict[str, tuple[str, ...]] = {
    "base": ("base",),
    "target": ("target",),
    "both": ("base", "target"),
}
SIGMA_RATIO = 0.5
DEFAULT = MotionRequest()


def bodies(system: str) -> dict[str, Body]:
    """Return the true bodies of a system; system "base" has no target."""
    table = load_bodies(ROBOTS / "bodies.yaml")
    found = {"base": table["base"]}
    if system != "base":
        found["target"] = table["target_leo"]
    return found


def config(system: str, scale: float = 1.0) -> Config:
    """Return a flight configuration; its unknown masses and inertias are `scale` times true."""
    unknown = SYSTEMS[system]
    entries = {
        name: _entry(body, scale if name in unknown else 1.0)
        for name, body in bodies(system).items()
    }
    joint = {
        "bus": "arm",
        "torque_limit_nm": 200.0,
        "speed_limit_rad_s": 1.0,
        "torque_noise_nm": TORQUE_NOISE_NM,
        "torque_offset_sigma_nm": TORQUE_OFFSET_SIGMA_NM,
        "position_noise_rad": POSITION_NOISE_RAD,
        "torque_scale_sigma_ratio": 0.0,
        "zero_sigma_rad": 0.0,
    }
    return Config.model_validate(
        {
            "robot": {"urdf": str(URDF), "tool_frame": "tool", "links_sigma_ratio": 0.0},
            "bodies": entries,
            "unknown": list(unknown),
            "buses": [{"name": "arm", "interface": "virtual", "channel": "a", "rate_hz": RATE_HZ}],
            "joints": [
                {"name": f"joint{k + 1}", "node_id": 0x11 + k, **joint} for k in range(JOINTS)
            ],
            "imu": {
                "port": "imu",
                "rate_hz": RATE_HZ,
                "mounting": {"p_BS_m": SENSOR_B_M, "q_BS_xyzw": (0.0, 0.0, 0.0, 1.0)},
                "gyro_group_delay_s": 2.2e-3,
                "acc_group_delay_s": 6.3e-3,
                "angle_random_walk_rad_sqrt_s": RATE_NOISE,
                "velocity_random_walk_m_s_sqrt_s": FORCE_NOISE,
                "gyro_bias_sigma_rad_s": GYRO_BIAS_SIGMA_RAD_S,
                "acc_bias_sigma_m_s2": ACC_BIAS_SIGMA_M_S2,
            },
            "scheduler": {"tick_rate_hz": RATE_HZ},
            "service": {"state_directory": "state"},
        }
    )


def subject(system: str) -> Subject:
    """Return the planner's subject (model, problem, prior) of a system."""
    return build_subject(config(system))


def planner(
    own: Subject, request: MotionRequest = DEFAULT, changes: dict[str, Any] | None = None
) -> Planner:
    """Return a planner with the paper's limits; `changes` replaces some of the limits."""
    kept = flight_limits.load(LIMITS).model_dump() | (changes or {})
    return Planner(own, flight_limits.MotionLimits.model_validate(kept), None, request)


def truth(system: str) -> Robot:
    """Return the true robot of a system, for MuJoCo."""
    found = bodies(system)
    return Robot.load(URDF, "tool", base=found["base"], target=found.get("target"))


def joint_spline(trajectory: Trajectory) -> JointSpline:
    """Return a planned trajectory as a spline of the bench."""
    return JointSpline(trajectory.duration_s, trajectory.points_rad)


def _entry(body: Body, scale: float) -> dict[str, Any]:
    mass, inertia = scale * body.mass_kg, [scale * x for x in body.inertia_kg_m2]
    return {
        "mass_kg": mass,
        "com_m": list(body.com_m),
        "inertia_kg_m2": inertia,
        "sigma": {
            "mass_kg": SIGMA_RATIO * mass,
            "com_m": [max(SIGMA_RATIO * abs(x), 0.2) for x in body.com_m],
            "inertia_kg_m2": [
                max(SIGMA_RATIO * abs(x), 0.1 * float(np.mean(inertia[::3]))) for x in inertia
            ],
        },
    }
