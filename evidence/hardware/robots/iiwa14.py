"""A KUKA LBR iiwa 14 with an empty flange: its joint torque sensors at 200 Hz."""

from __future__ import annotations

from functools import partial

import numpy as np

from evidence.hardware.arms import Arm, FloatArray, Motion, Read, Run, friction
from evidence.hardware.data_set import DataSet

N = 7
STEP_S = 5e-3
JOINTS = [f"iiwa_joint_{k + 1}" for k in range(N)]
FRICTION_OF_NM = 20.0  # a twentieth of it is the friction after the sensors
ANGLE_NOISE_RAD = 1e-5
_ARM = "drake/examples/kuka_iiwa_arm"
_DATA = f"{_ARM}/experiment_data/friction_model"
_URDF = f"{_ARM}/urdf/iiwa14_estimated_params.urdf"

_TIME, _POSITION, _TORQUE = "cur_traj_time_s", "joint_position_measured", "joint_torque_measured"
_SHA256 = {  # of the three files of each run
    "joint6_7_dynamic_motion": (
        "74bb3f37cc2bb750ef134b4f49d983e13f8e85637333c5177312bbca2fff39c0",
        "0e11b59a606bf2abfce4e1bf07cb0fca31f8fea80b2947c583fb1cb70d708bfe",
        "e6f34ca233e6093889d42572f0c04ac60ac3e9a8995187ce18172eba0a9f4794",
    ),
    "joint_2_to_7_dynamic_motion": (
        "b7367e5c41ea38280a554406ee12a8b082211f5b5ca625ff67fdcb78a9b83d60",
        "0e70129f696d7adcb6f93793a346bbd2d2f405ed08fdf0395dfc2ad853ab36e8",
        "adad9d6c6eae7477d1f5eeb125ba9d49cd8292d73829a588dace94795d4c01ba",
    ),
    "joint_3_to_7_dynamic_motion": (
        "6e448da1dcf14f467d19c68bc626679d20741feba5e160f4ca90855d7ba34ea1",
        "dec587b14a59d7931100ccf586e6529f1cde236fe3fd3521316de9f7d50f4d72",
        "278e9b331845f0b87b0ad6a15ea1bb8850e96ada24f87f32598b8f99ac1674db",
    ),
    "joint_3_to_7_dynamic_motion_nice_data1": (
        "964ff6d34c526fb5d072ecb2732c6971d154b2002e21bda7642fbdf2357c7635",
        "bd34bba22913625e53cff1e7d832dba17c0e613bebaa57afa2cc85d231b33a5c",
        "f820bb0b2d056ff21117d4e3cc4a88b17f2b84f4dec71763ec36a61621099a3d",
    ),
}

DATA = DataSet(
    what="KUKA iiwa 14, empty, 200 Hz: Harvard Agile Robotics Lab, in the history of its Drake",
    repository="HarvardAgileRoboticsLab/drake",
    commit="eba55ebd3b4ca312cc028c3fc9e02816f0955d00",
    licence="BSD-3-Clause",
    files={_URDF: "7bde770d04086ff0621fdc95c8866bcbf801b7e5260b064da51abe1da1196aa3"}
    | {
        f"{_DATA}/{run}/{name}.txt": own
        for run, hashes in _SHA256.items()
        for name, own in zip((_TIME, _POSITION, _TORQUE), hashes, strict=True)
    },
)


def _table(run: str, name: str, read: Read) -> FloatArray:
    lines = read(DATA, f"{_DATA}/{run}/{name}.txt").decode().splitlines()
    return np.array([line.split() for line in lines if line.strip()], float)


def _motion(run: str, read: Read) -> Motion:
    """Return a run as one motion.

    The log's time begins again at 0 with each part of the motion. The arm rests between the parts,
    so they are put one behind the other.
    """
    t = _table(run, _TIME, read)[:, 0]
    steps = np.diff(t)
    t = np.concatenate([[0.0], np.cumsum(np.where(steps > 0.0, steps, STEP_S))])
    q, tau = (_table(run, kind, read) for kind in (_POSITION, _TORQUE))
    return Motion(t, q, tau)


def _run(name: str, empty: str, *, held: bool = False) -> Run:
    return Run(name=name, payload_kg=0.0, motion=partial(_motion, name), empty=empty, held_out=held)


ARMS = (
    Arm(
        name="iiwa14",
        data_sets=[DATA],
        urdf=lambda read: read(DATA, _URDF),
        tool="iiwa_link_ee",
        guess_kg=1.0,
        rate_hz=1.0 / STEP_S,
        joints=JOINTS,
        overlay={
            "robot": {"links_sigma_ratio": 0.2},
            "joints": friction(dict.fromkeys(JOINTS, FRICTION_OF_NM), ANGLE_NOISE_RAD),
        },
        torque={"sign": -1},  # the controller logs the torque of the load
        runs=[
            _run("joint6_7_dynamic_motion", "joint_2_to_7_dynamic_motion"),
            _run("joint_2_to_7_dynamic_motion", "joint6_7_dynamic_motion"),
            _run("joint_3_to_7_dynamic_motion", "joint_2_to_7_dynamic_motion", held=True),
            _run(
                "joint_3_to_7_dynamic_motion_nice_data1",
                "joint_2_to_7_dynamic_motion",
                held=True,
            ),
        ],
    ),
)
