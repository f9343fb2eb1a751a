"""Data as a laboratory would have them: irregular samples of the bench's truth, with noise.

Raw values, as the sensors give them: sign, zero and units are left to mapping and configuration.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from hil.run.bench import Setup

RATE_HZ = 30.0
JITTER_RATIO = 0.3  # of a period, uniform to either side
LOST_RATIO = 0.02
WINDOW_S = 0.8
POSITION_NOISE_RAD = 1e-5
EPOCH_S = 1_760_000_000
AXES = "xyz"

Columns = dict[str, np.ndarray]


def faults(said: str) -> list[str]:
    """Return the lines of stderr that are no progress."""
    progress = ("fsw: import: ", "fsw: identify: ")
    return [line for line in said.splitlines() if not line.startswith(progress)]


def sampled_config(setup: Setup, name: str = "sampled.yaml", **changes: Any) -> Path:
    """Write the flight's configuration for samples at 30 Hz; return its path."""
    data = yaml.safe_load(setup.config_path.read_text())
    data["buses"] = [{"name": "arm", "interface": "samples", "rate_hz": RATE_HZ}]
    for joint in data["joints"]:
        joint["position_noise_rad"] = POSITION_NOISE_RAD
    data["imu"] |= {
        "driver": "samples",
        "rate_hz": RATE_HZ,
        "gyro_group_delay_s": 0.0,
        "acc_group_delay_s": 0.0,
    }
    del data["star_tracker"]
    data["scheduler"]["tick_rate_hz"] = RATE_HZ
    data["estimator"] |= {"window_s": WINDOW_S}
    path = setup.folder / name
    path.write_text(yaml.safe_dump(data | changes))
    return path


def times_s(setup: Setup, rng: np.random.Generator) -> np.ndarray:
    """Return irregular times (k,) of the motion [s]."""
    t = np.arange(1.0, setup.history.end_s * RATE_HZ - 1.0)
    t = (t + rng.uniform(-JITTER_RATIO, JITTER_RATIO, len(t))) / RATE_HZ
    return t[rng.random(len(t)) >= LOST_RATIO]


def sampled(setup: Setup, config: Path, seed: int) -> tuple[Columns, Columns]:
    """Return columns of the joints, then of the inertial unit, each with its times `t`."""
    data = yaml.safe_load(config.read_text())
    rng = np.random.default_rng([seed, 18])
    t = times_s(setup, rng)
    state = setup.history.at(t)
    joints: Columns = {"t": t}
    for k, joint in enumerate(data["joints"]):
        q = state.q[:, k] + joint["zero_offset_rad"] + rng.normal(0, POSITION_NOISE_RAD, len(t))
        tau = state.tau[:, k] + rng.normal(0, joint["torque_offset_sigma_nm"])
        tau = tau + rng.normal(0, joint["torque_noise_nm"], len(t))
        joints[f"q_{joint['name']}"] = joint["sign"] * q
        joints[f"tau_{joint['name']}"] = joint["sign"] * tau
    unit = data["imu"]
    t = times_s(setup, rng)
    state = setup.history.at(t)
    R_BS = Rotation.from_quat(unit["mounting"]["q_BS_xyzw"]).as_matrix()
    p = np.array(unit["mounting"]["p_BS_m"])
    force = state.a_NB_B - state.g_NB_B + np.cross(state.wd_NB_B, p)
    force = force + np.cross(state.w_NB_B, np.cross(state.w_NB_B, p))
    inertial: Columns = {"t": t}
    for name, value, walk, bias in (
        ("w", state.w_NB_B, "angle_random_walk_rad_sqrt_s", "gyro_bias_sigma_rad_s"),
        ("f", force, "velocity_random_walk_m_s_sqrt_s", "acc_bias_sigma_m_s2"),
    ):
        noise = rng.normal(0, unit[walk] * RATE_HZ**0.5, value.shape)
        measured = value @ R_BS + rng.normal(0, unit[bias], 3) + noise
        inertial |= {f"{name}{axis}": measured[:, k] for k, axis in enumerate(AXES)}
    return joints, inertial


def as_arrays(joints: Columns, inertial: Columns) -> Columns:
    """Return the columns of `sampled` as the arrays of `fsw.Samples`, by its fields."""

    def stacked(columns: Columns, first: str) -> np.ndarray:
        return np.column_stack([own for name, own in columns.items() if name.startswith(first)])

    return {
        "t_s": joints["t"],
        "q": stacked(joints, "q_"),
        "tau": stacked(joints, "tau_"),
        "t_imu_s": inertial["t"],
        "gyro_rad_s": stacked(inertial, "w"),
        "specific_force_m_s2": stacked(inertial, "f"),
    }


def in_the_robots_axes(arrays: Columns, config: Path) -> Columns:
    """Return arrays with sign and zero of the joints applied, inertial ones in axes B."""
    data = yaml.safe_load(config.read_text())
    signs = np.array([joint["sign"] for joint in data["joints"]])
    zeros = np.array([joint["zero_offset_rad"] for joint in data["joints"]])
    R_BS = Rotation.from_quat(data["imu"]["mounting"]["q_BS_xyzw"]).as_matrix()
    return arrays | {
        "q": signs * arrays["q"] - zeros,
        "tau": signs * arrays["tau"],
        **{name: arrays[name] @ R_BS.T for name in ("gyro_rad_s", "specific_force_m_s2")},
    }


def write_csv(path: Path, columns: Columns) -> Path:
    """Write columns with a header; all digits of every number."""
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_bag(
    path: Path, joints: Columns, inertial: Columns, names: list[str], *, is_stamped: bool = True
) -> Path:
    """Write a ROS 2 bag of JointState and Imu as rosbags' own writer makes it; stamps have ns."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic, kind, columns in (
            ("/joint_states", "sensor_msgs/msg/JointState", joints),
            ("/imu", "sensor_msgs/msg/Imu", inertial),
        ):
            connection = bag.add_connection(topic, kind, typestore=store)
            for k, t in enumerate(columns["t"].tolist()):
                ns = round((EPOCH_S + t) * 1e9)
                sec, nanosec = divmod(ns if is_stamped else 0, 10**9)
                stamp = kinds["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
                header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
                message = _message(kinds, kind, header, columns, k, names)
                bag.write(connection, ns + 2_000_000, store.serialize_cdr(message, kind))
    return path


def _message(
    kinds: Mapping[str, Any], kind: str, header: Any, columns: Columns, k: int, names: list[str]
) -> Any:
    if kind.endswith("JointState"):
        return kinds[kind](
            header=header,
            name=names,
            position=np.array([columns[f"q_{name}"][k] for name in names]),
            velocity=np.zeros(0),
            effort=np.array([columns[f"tau_{name}"][k] for name in names]),
        )
    vector, zeros = kinds["geometry_msgs/msg/Vector3"], np.zeros(9)
    return kinds[kind](
        header=header,
        orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=zeros,
        angular_velocity=vector(**{a: float(columns[f"w{a}"][k]) for a in AXES}),
        angular_velocity_covariance=zeros,
        linear_acceleration=vector(**{a: float(columns[f"f{a}"][k]) for a in AXES}),
        linear_acceleration_covariance=zeros,
    )
