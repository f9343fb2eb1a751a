"""Two Panda arms with empty flanges: link-side torques at 1 kHz and 30 Hz."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.hardware.arms import Arm, FloatArray, Motion, Read, Run
from evidence.hardware.data_set import DataError, DataSet

N = 7
SECOND_HZ = 30.0
URDF = Path(__file__).parents[3] / "hil" / "robots" / "panda.urdf"
CONFIG = Path(__file__).with_name("panda.yaml")
FEW = {"window_s": 0.4, "min_fill_ratio": 1.0, "nodes": 3}  # at 30 Hz
FEW_NOISE_RAD = 2e-4  # times in the bag scatter by 0.25 ms, and joints turn at up to 1 rad/s
STEP_S = 1e-3  # period of the first arm's controller
MOVING_RAD_S = 0.3  # below this rate, the change of the angles does not show the elapsed time
LONGEST_STEPS = 10  # longest accepted gap between two samples
_LOG = "matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj_"
_BAG = "franka_inria_inverse_dynamics_solver/bagfiles/panda_exciting_trajectory.db3"

FIRST = DataSet(
    what="Panda, 1 kHz, 21 s, no payload: Gaz et al., IEEE RA-L 4(4), 2019",
    repository="marcocognetti/FrankaEmikaPandaDynModel",
    commit="24d85ce4e648e2e894c832bfeee9b16711eb1a1a",
    licence="GPL-3.0",
    files={
        f"{_LOG}positions.txt": "50bf82a082c439aff8220e8142985c8dd783f7ddc1415987cd75c9efb88bcf69",
        f"{_LOG}velocity.txt": "3340f299e926c501b66d540fa461ea0a7184b8dda32e505ebed062db57860d49",
        f"{_LOG}torques.txt": "11fda32785bb29ce444e14e0f45f4893aab7142dc6ee29576d828ab154852f9c",
    },
)
SECOND = DataSet(
    what="another Panda, 30 Hz, 24 s, no payload: inverse_dynamics_solver, University of Salerno",
    repository="unisa-acg/inverse-dynamics-solver",
    commit="41e196de5ca340f2b48e443484a7c74a77533da4",
    licence="BSD-3-Clause",
    files={_BAG: "6794c9dc89628d775bd77bfaee3ed73e0a7d7716401886e17e06d81ea3b7f299"},
)


def clock(q_rad: FloatArray, qd_rad_s: FloatArray) -> FloatArray:
    """Return the times (k,) [s] of samples, from angles (k, n) and measured rates (k, n).

    The times in the log are those of its writer, wrong by up to 8 ms. The controller has a fixed
    period; the change of the angles over the rates gives the number of periods between samples.
    """
    mean = 0.5 * (qd_rad_s[1:] + qd_rad_s[:-1])
    speed = np.sum(mean**2, axis=1)
    went = np.sum(np.diff(q_rad, axis=0) * mean, axis=1)
    steps = np.ones(len(mean))
    known = speed > MOVING_RAD_S**2
    steps[known] = np.clip(np.rint(went[known] / speed[known] / STEP_S), 1.0, LONGEST_STEPS)
    return np.concatenate([[0.0], STEP_S * np.cumsum(steps)])


def _first(read: Read) -> Motion:
    q, qd, tau = (
        np.array(read(FIRST, f"{_LOG}{kind}.txt").split(), float).reshape(-1, N)
        for kind in ("positions", "velocity", "torques")
    )
    # the logger was not synchronous with the controller: it repeats or misses some samples
    fresh = np.concatenate([[True], (np.diff(q, axis=0) != 0.0).any(axis=1)])
    q, qd, tau = q[fresh], qd[fresh], tau[fresh]
    return Motion(clock(q, qd), q, tau)


def _second(read: Read) -> Motion:
    """Return the second arm's motion. Raise DataError if the bag cannot be read."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with sqlite3.connect(":memory:") as bag:
            bag.deserialize(read(SECOND, _BAG))
            rows = bag.execute("select timestamp, data from messages order by timestamp").fetchall()
    except sqlite3.Error as error:
        raise DataError(f"{_BAG}: {error}") from error
    states: list[Any] = [
        store.deserialize_cdr(data, "sensor_msgs/msg/JointState") for _, data in rows
    ]
    return Motion(
        np.array([stamp for stamp, _ in rows]) * 1e-9,
        np.array([state.position for state in states]),
        np.array([state.effort for state in states]),
    )


def _configuration(rate_hz: float) -> str:
    """Return the configuration; below 100 Hz a window needs all samples and fewer nodes."""
    document = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    document["buses"][0]["rate_hz"] = document["scheduler"]["tick_rate_hz"] = rate_hz
    if rate_hz == SECOND_HZ:
        document["estimator"] = FEW
        for joint in document["joints"]:
            joint["position_noise_rad"] = FEW_NOISE_RAD
    text: str = yaml.safe_dump(document, sort_keys=False)
    return text


def _half(whole: Callable[[Read], Motion], start: float, read: Read) -> Motion:
    return whole(read).part(start, start + 0.5)


def _halves(whole: Callable[[Read], Motion]) -> list[Run]:
    """Return two runs, each of which is judged with the arm of the other."""
    return [
        Run(
            name=f"half {name}",
            payload_kg=0.0,
            motion=partial(_half, whole, start),
            empty=f"half {other}",
            alone=False,
        )
        for name, other, start in (("a", "b", 0.0), ("b", "a", 0.5))
    ]


def _arm(name: str, data: DataSet, rate_hz: float, bound_nm: float, runs: list[Run]) -> Arm:
    return Arm(
        name=name,
        data_sets=[data],
        urdf=lambda _: URDF.read_bytes(),
        configuration=partial(_configuration, rate_hz),
        tool="flange",
        guess_kg=0.5,
        rate_hz=rate_hz,
        joints=[f"joint{k + 1}" for k in range(N)],
        runs=runs,
        residual_bound_nm=bound_nm,
    )


# Bounds of the rms residual of held-out torques [N m]. First arm: least squares with a friction
# model reaches 0.132. Second arm: the first arm's published model with friction leaves 0.344.
# The published arm was identified from the first recording, so that this is not judged as a whole.
ARMS = (
    _arm("panda-1", FIRST, 1.0 / STEP_S, 0.14, _halves(_first)),
    _arm(
        "panda-2",
        SECOND,
        SECOND_HZ,
        0.344,
        [*_halves(_second), Run(name="whole", payload_kg=0.0, motion=_second)],
    ),
)
