"""Recordings of two Panda arms with empty flanges, as tables that `fsw import` reads."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.evidence.hardware.data_set import DataError, DataSet

FloatArray = NDArray[np.float64]

N = 7
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


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Angles and torques of all joints at common times."""

    t_s: FloatArray  # (k,) times
    q_rad: FloatArray  # (k, 7)
    tau_nm: FloatArray  # (k, 7)
    rate_hz: float

    def part(self, start: float, stop: float) -> Motion:
        """Return the samples between two shares of their number, from 0 to 1."""
        own = slice(round(start * len(self.t_s)), round(stop * len(self.t_s)))
        return Motion(self.t_s[own], self.q_rad[own], self.tau_nm[own], self.rate_hz)

    def write(self, path: Path) -> None:
        """Write a CSV file with the columns t_s, q_jointK [rad] and tau_jointK [N m]."""
        names = [f"{kind}_joint{k + 1}" for kind in ("q", "tau") for k in range(N)]
        table = np.column_stack([self.t_s, self.q_rad, self.tau_nm])
        header = ",".join(["t_s", *names])
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")


def first(folder: Path) -> Motion:
    """Return the first arm's motion.

    Raises
    ------
    DataError if the data are missing or differ from the published data.
    """
    q, qd, tau = (
        np.loadtxt(FIRST.read(folder, f"{_LOG}{kind}.txt")).reshape(-1, N)
        for kind in ("positions", "velocity", "torques")
    )
    # the logger was not synchronous with the controller: it repeats or misses some samples
    fresh = np.concatenate([[True], (np.diff(q, axis=0) != 0.0).any(axis=1)])
    q, qd, tau = q[fresh], qd[fresh], tau[fresh]
    return Motion(clock(q, qd), q, tau, 1.0 / STEP_S)


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


def second(folder: Path) -> Motion:
    """Return the second arm's motion.

    Raises
    ------
    DataError if the data are missing, differ from the published data, or cannot be read.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with sqlite3.connect(f"file:{SECOND.read(folder, _BAG)}?mode=ro", uri=True) as bag:
            rows = bag.execute("select timestamp, data from messages order by timestamp").fetchall()
    except sqlite3.Error as error:
        raise DataError(f"{SECOND.place(folder, _BAG)}: {error}") from error
    states: list[Any] = [
        store.deserialize_cdr(data, "sensor_msgs/msg/JointState") for _, data in rows
    ]
    return Motion(
        np.array([stamp for stamp, _ in rows]) * 1e-9,
        np.array([state.position for state in states]),
        np.array([state.effort for state in states]),
        30.0,
    )
