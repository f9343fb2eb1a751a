"""Table 1's robot for the estimator tests: configuration, true motion, windows and blocks."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import to_parameters
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, ChannelWindow, FloatArray, Window
from hil.world.history import TruthHistory
from hil.world.spline import JointSpline
from hil.world.truth import Body, Robot, load_bodies, simulate

HIL = Path(__file__).parents[2] / "hil"
URDF = HIL / "robots" / "lbr3_satellite.urdf"
TWO_ARMS = HIL / "robots" / "two_arm_satellite.urdf"
BODIES = load_bodies(HIL / "robots" / "bodies.yaml")
BASE, TARGET = BODIES["base"], BODIES["target_leo"]
N = 7
RATE_HZ = 500.0
WINDOW_S = 0.4
NODES = 4
SENSOR_B_M = (0.1, 0.2, -0.3)
POSITION_NOISE_RAD = 1.08e-7  # 24 bit encoder, uniform quantisation
TORQUE_NOISE_NM = 0.05
GYRO_NOISE = 4.4e-5 * RATE_HZ**0.5
ACC_NOISE = 5e-4 * RATE_HZ**0.5
MOTION = {"base": "base_identification", "target": "target_leo_identification"}


def plain(body: Body, sigma_ratio: float = 0.5) -> dict[str, Any]:
    """Return a body's configuration; sigma relative, with a floor for small components."""
    return {
        "mass_kg": body.mass_kg,
        "com_m": list(body.com_m),
        "inertia_kg_m2": list(body.inertia_kg_m2),
        "sigma": {
            "mass_kg": sigma_ratio * body.mass_kg,
            "com_m": [max(sigma_ratio * abs(x), 0.2) for x in body.com_m],
            "inertia_kg_m2": [max(sigma_ratio * abs(x), 30.0) for x in body.inertia_kg_m2],
        },
    }


def wrong(body: Body, rng: np.random.Generator) -> Body:
    """Return the body with every component 30-50 % off, inertia by one factor (still physical)."""

    def factor(size: int | None = None) -> Any:
        return 1.0 + rng.choice([-1.0, 1.0], size) * rng.uniform(0.3, 0.5, size)

    return Body(
        float(body.mass_kg * factor()),
        tuple(np.array(body.com_m) * factor(3)),
        tuple(np.array(body.inertia_kg_m2) * factor()),
    )


def parameters(body: Body) -> FloatArray:
    return to_parameters(body.mass_kg, np.array(body.com_m), np.array(body.inertia_kg_m2))


def make_config(
    unknown: tuple[str, ...] = ("target",),
    *,
    base: Body = BASE,
    target: Body | None = TARGET,
    biases: bool = True,
    doubt: bool = False,
    **estimator: Any,
) -> Config:
    bodies = {"base": plain(base)}
    if target is not None:
        bodies["target"] = plain(target)
    for name, body in bodies.items():
        if name not in unknown:  # known: exact, or as uncertain as the links
            del body["sigma"]
    joint = {
        "bus": "arm",
        "torque_limit_nm": 100.0,
        "speed_limit_rad_s": 2.0,
        "torque_noise_nm": TORQUE_NOISE_NM,
        "torque_offset_sigma_nm": 0.2 if biases else 0.0,
        "torque_scale_sigma_ratio": 0.01 if doubt else 0.0,
        "zero_sigma_rad": 2e-3 if doubt else 0.0,
        "position_noise_rad": POSITION_NOISE_RAD,
    }
    settings = {"window_s": WINDOW_S, "nodes": NODES, "settle_blocks": 5, **estimator}
    return Config.model_validate(
        {
            "robot": {
                "urdf": str(URDF),
                "tool_frame": "tool",
                "links_sigma_ratio": 0.05 if doubt else 0.0,
            },
            "bodies": bodies,
            "unknown": list(unknown),
            "buses": [{"name": "arm", "interface": "virtual", "channel": "a", "rate_hz": RATE_HZ}],
            "joints": [{"name": f"joint{k + 1}", "node_id": 0x11 + k, **joint} for k in range(N)],
            "imu": {
                "port": "/dev/imu",
                "rate_hz": RATE_HZ,
                "mounting": {"p_BS_m": SENSOR_B_M, "q_BS_xyzw": (0.0, 0.0, 0.0, 1.0)},
                "gyro_group_delay_s": 0.0022,
                "acc_group_delay_s": 0.0063,
                "angle_random_walk_rad_sqrt_s": GYRO_NOISE / RATE_HZ**0.5,
                "velocity_random_walk_m_s_sqrt_s": ACC_NOISE / RATE_HZ**0.5,
                "gyro_bias_sigma_rad_s": 2e-5 if biases else 0.0,
                "acc_bias_sigma_m_s2": 0.01 if biases else 0.0,
                "mounting_position_sigma_m": 0.01 if doubt else 0.0,
                "mounting_angle_sigma_rad": 5e-3 if doubt else 0.0,
                "gyro_scale_sigma_ratio": 5e-3 if doubt else 0.0,
                "gyro_axes_sigma_rad": 5e-3 if doubt else 0.0,
            },
            "scheduler": {"tick_rate_hz": RATE_HZ},
            "estimator": settings,
            "service": {"state_directory": "state"},
        }
    )


@lru_cache(maxsize=1)
def robot_model() -> RobotModel:
    return RobotModel(URDF, "tool")


def make_problem(unknown: tuple[str, ...] = ("target",), **options: Any) -> Problem:
    return build_problem(make_config(unknown, **options), robot_model())


@lru_cache(maxsize=2)
def motion(kind: str) -> TruthHistory:
    """Return the true motion: arm alone ("base") or with the grasped target."""
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION[kind]}.yaml")
    target = TARGET if kind == "target" else None
    robot = Robot.load(URDF, "tool", base=BASE, target=target)
    return simulate(robot, spline, -3.0, spline.duration_s + 1.0, dt_s=0.005)


@lru_cache(maxsize=1)
def covariances() -> dict[str, FloatArray]:
    """Return what conditioning leaves of white noise in a full window at the nodes."""
    half = WINDOW_S / 2
    t = np.arange(-half, half - 1e-9, 1 / RATE_HZ) + 0.5 / RATE_HZ
    low, high = NodeFit(t, half, NODES - 1, NODES), NodeFit(t, half, NODES + 2, NODES)
    return {
        "cov_joint": np.stack([high.covariance((1, 2, 0), POSITION_NOISE_RAD)] * N),
        "cov_tau": np.stack([low.covariance((0,), TORQUE_NOISE_NM)] * N),
        "cov_gyro": low.covariance((0, 1), GYRO_NOISE),
        "cov_acc": low.covariance((0,), ACC_NOISE),
    }


def true_block(history: TruthHistory, start_s: float, index: int = 0) -> Block:
    """Return the noise-free block of the window that starts at `start_s`, biases zero."""
    t = start_s + WINDOW_S / 2 * (1 + gauss_nodes(NODES))
    s = history.at(t)
    r = np.array(SENSOR_B_M)
    f = s.a_NB_B + np.cross(s.wd_NB_B, r) + np.cross(s.w_NB_B, np.cross(s.w_NB_B, r))
    return Block(
        index=index,
        t_ns=np.rint(t * 1e9).astype(np.int64),
        q_rad=s.q,
        qd_rad_s=s.qd,
        qdd_rad_s2=s.qdd,
        tau_nm=s.tau,
        w_NB_B_rad_s=s.w_NB_B,
        wd_NB_B_rad_s2=s.wd_NB_B,
        f_NS_B_m_s2=f,
        R_NB=s.R_NB,
        **covariances(),
        has_joint=np.ones(N, dtype=bool),
        has_gyro=True,
        has_accelerometer=True,
        has_attitude=True,
    )


def _factor(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def noisy(block: Block, rng: np.random.Generator, biases: dict[str, FloatArray]) -> Block:
    """Return the block with Gaussian errors of its covariances and constant biases added."""
    m = len(block.t_ns)
    joint = np.stack([_factor(c) @ rng.normal(size=len(c)) for c in block.cov_joint], axis=1)
    tau = np.stack([_factor(c) @ rng.normal(size=m) for c in block.cov_tau], axis=1)
    gyro = _factor(block.cov_gyro) @ rng.normal(size=(2 * m, 3))
    acc = _factor(block.cov_acc) @ rng.normal(size=(m, 3))
    return replace(
        block,
        qd_rad_s=block.qd_rad_s + joint[:m],
        qdd_rad_s2=block.qdd_rad_s2 + joint[m : 2 * m],
        q_rad=block.q_rad + (joint[2 * m :] if len(joint) > 2 * m else 0.0),
        tau_nm=block.tau_nm + tau + biases["torque"],
        w_NB_B_rad_s=block.w_NB_B_rad_s + gyro[:m] + biases["gyro"],
        wd_NB_B_rad_s2=block.wd_NB_B_rad_s2 + gyro[m:],
        f_NS_B_m_s2=block.f_NS_B_m_s2 + acc + biases["acc"],
    )


def at_rest(block: Block) -> Block:
    """Return the block as the conditioning gives it when no joint moves: rates exactly zero."""
    zero = np.zeros_like(block.qd_rad_s)
    return replace(block, qd_rad_s=zero, qdd_rad_s2=zero)


def draw_biases(rng: np.random.Generator) -> dict[str, FloatArray]:
    return {
        "torque": rng.normal(size=N) * 0.1,
        "gyro": rng.normal(size=3) * 2e-5,
        "acc": rng.normal(size=3) * 0.01,
    }


def true_blocks(kind: str, stop_s: float = 59.9, start_s: float = 0.0) -> list[Block]:
    history = motion(kind)
    count = int(np.floor((stop_s - start_s) / WINDOW_S))
    return [true_block(history, start_s + k * WINDOW_S, k) for k in range(count)]


def noisy_blocks(kind: str, seed: int, stop_s: float = 59.9) -> list[Block]:
    rng = np.random.default_rng(seed)
    biases = draw_biases(rng)
    return [noisy(block, rng, biases) for block in true_blocks_cached(kind, stop_s)]


@lru_cache(maxsize=2)
def whole_motion(kind: str) -> tuple[Block, ...]:
    return tuple(true_blocks(kind))


def true_blocks_cached(kind: str, stop_s: float) -> tuple[Block, ...]:
    return whole_motion(kind)[: int(np.floor(stop_s / WINDOW_S))]


def random_block(seed: int = 1) -> Block:
    """Return a block of arbitrary motion, unit covariances, for derivative checks."""
    rng = np.random.default_rng(seed)
    m = NODES
    Q = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(m)]
    return Block(
        index=0,
        t_ns=np.arange(m, dtype=np.int64),
        q_rad=rng.normal(size=(m, N)),
        qd_rad_s=0.2 * rng.normal(size=(m, N)),
        qdd_rad_s2=0.1 * rng.normal(size=(m, N)),
        tau_nm=rng.normal(size=(m, N)),
        w_NB_B_rad_s=0.1 * rng.normal(size=(m, 3)),
        wd_NB_B_rad_s2=0.1 * rng.normal(size=(m, 3)),
        f_NS_B_m_s2=0.1 * rng.normal(size=(m, 3)),
        R_NB=np.stack([R * np.linalg.det(R) for R in Q]),
        cov_joint=np.stack([1e-6 * np.eye(2 * m)] * N),
        cov_tau=np.stack([1e-4 * np.eye(m)] * N),
        cov_gyro=1e-6 * np.eye(2 * m),
        cov_acc=1e-6 * np.eye(m),
        has_joint=np.ones(N, dtype=bool),
        has_gyro=True,
        has_accelerometer=True,
        has_attitude=True,
    )


def noisy_angles() -> Block:
    """Return a block that has the covariance of angles, correlated with rates."""
    block, size = random_block(2), 3 * NODES
    root = 1e-3 * np.random.default_rng(5).normal(size=(N, size, size))
    return replace(block, cov_joint=root @ root.transpose(0, 2, 1))


def channel(t_s: FloatArray, values: FloatArray, *, missing: bool = False) -> ChannelWindow:
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    return ChannelWindow(t_ns=t_ns, values=values, missing=missing, stale=False)


NO_ATTITUDE = channel(np.empty(0), np.empty((0, 4)), missing=True)


def windows(history: TruthHistory, seed: int, start_s: float, stop_s: float) -> Iterator[Window]:
    """Yield sampled noisy windows: 500 Hz joints, an IMU on a clock of its own, no biases."""
    rng = np.random.default_rng(seed)
    for k in range(int(np.floor((stop_s - start_s) / WINDOW_S + 1e-9))):
        a = start_s + k * WINDOW_S
        yield sampled_window(history, rng, a, k)


def sampled_window(
    history: TruthHistory, rng: np.random.Generator, start_s: float, index: int = 0
) -> Window:
    count = round(WINDOW_S * RATE_HZ)
    t = start_s + (np.arange(count) + 0.3) / RATE_HZ
    ti = start_s + (np.arange(count) + 0.6) / RATE_HZ
    s, i = history.at(t), history.at(ti)
    r = np.array(SENSOR_B_M)
    f = i.a_NB_B + np.cross(i.wd_NB_B, r) + np.cross(i.w_NB_B, np.cross(i.w_NB_B, r))
    q = s.q + POSITION_NOISE_RAD * rng.normal(size=s.q.shape)
    tau = s.tau + TORQUE_NOISE_NM * rng.normal(size=s.q.shape)
    return Window(
        index=index,
        start_ns=round(start_s * 1e9),
        stop_ns=round((start_s + WINDOW_S) * 1e9),
        joints=tuple(channel(t, np.stack([q[:, j], tau[:, j]], axis=1)) for j in range(N)),
        gyro=channel(ti, i.w_NB_B + GYRO_NOISE * rng.normal(size=f.shape)),
        accelerometer=channel(ti, f + ACC_NOISE * rng.normal(size=f.shape)),
        attitude=NO_ATTITUDE,
    )
