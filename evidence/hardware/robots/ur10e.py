"""A Universal Robots UR10e, loaded and empty: angles and motor currents at 100 Hz."""

from __future__ import annotations

from functools import partial

import numpy as np

from evidence.hardware.arms import Arm, Motion, Read, Run, motor_current
from evidence.hardware.data_set import DataSet

N = 6
COLUMNS = 1 + 5 * N
LONGEST_STEP_S = 1.0
# "drvGains" of UR10E_parameters.txt in the repository [N m/A]: motor current to joint torque
GAINS_NM_A = [10.0, 10.6956, 8.4566, 9.0029, 9.48, 10.1232]
JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
LIMITS_NM = dict(zip(JOINTS, (330.0, 330.0, 150.0, 54.0, 54.0, 54.0), strict=True))
ANGLE_NOISE_RAD = 5e-5  # angles are printed to 1e-4 rad
_URDF = "URe/urdf/ur10e.urdf"
_FOLDER = "dataset_ur10e/identification_data/ur-"
_SHA256 = {
    "19_12_23_free": "62555d25fdcb989b6c97a9194f2c13d8cccdce99457c55696b83e107030f2a1f",
    "20_01_13-load_2600": "720e7a265a35173a7e60bcc180344e37d7c58d86498dd56ef4956733f7f65b8a",
    "20_01_31-load": "5abab622cdbd53db78fe3ec72485535c55ec5db412a179ae26bb9da6bea5441c",
    "20_01_31-unload": "513feea3e662364fad89214d5ff49e6ef96e02d56f85b4de57a408fc2563cb1c",
    "20_02_05-20sec_8harm": "5456696773b5e3e12510640aab6049c65f4259c99880951bd71e1c74f8cb44e5",
    "20_02_10-30sec_12harm": "341fff80f177be564c8720ea898165addfd46d7cbe6f3ffd8923eeaae0eef000",
    "20_02_12-50sec_12harm": "bb48cca42716a88f8b255d2d1b3eb3fa4a6eac4a9a52b694d4c1066ce8b4ca51",
    "20_02_19_14harm50sec": "cd503afc985c41a6ad8fbe47d443c961eadbde4822a87ff3e17adcb2a24fa103",
    "20_02_19_14harm50secLoad": "e689a99e5ff00ac38d03a2b9302e77688de0db8388b1d9c0e6aad3f77962758c",
    "20_02_19_15harm50sec": "23d367463e0b1ad3fde0581304178fefc46a4729dfc97ea5dfaf23fdd5e30dcf",
    "20_02_19_15harm50secLoad": "8e1db750ccc2cde660cf73d459eca0c6ff79a5a1cd60d715ef742ae06cbd800d",
}

DATA = DataSet(
    what="UR10e, 100 Hz, motor currents: Mamedov and Mikhel, Frontiers in Robotics and AI 7, 2020",
    repository="shamilmamedov/dynamic_calibration",
    commit="11af40e7deb758ec080a175fed8fcdd6c99aca29",
    licence="none stated",
    files={_URDF: "0d2abc6ebc70725c691a35aa6c2d03fd6e8158017a1b7da7a10a3ef52de7b821"}
    | {f"{_FOLDER}{run}.csv": own for run, own in _SHA256.items()},
)


def _motion(name: str, read: Read) -> Motion:
    text = read(DATA, f"{_FOLDER}{name}.csv").decode()
    lines = (line.split(",") for line in text.split())
    # time, angles, rates, currents, wanted currents and torques; the last line may be cut, and the
    # first ones damaged
    table = np.array([line for line in lines if len(line) == COLUMNS], float)
    steps = np.diff(table[:, 0])
    parts = np.split(table, np.flatnonzero((steps <= 0.0) | (steps > LONGEST_STEP_S)) + 1)
    table = max(parts, key=len)
    return Motion(table[:, 0] - table[0, 0], table[:, 1 : 1 + N], table[:, 1 + 2 * N : 1 + 3 * N])


def _run(name: str, payload_kg: float = 0.0, empty: str | None = None, held: bool = False) -> Run:
    return Run(
        name=name,
        payload_kg=payload_kg,
        motion=partial(_motion, name),
        empty=empty,
        held_out=held,
    )


ARMS = (
    Arm(
        name="ur10e",
        data_sets=[DATA],
        urdf=lambda read: read(DATA, _URDF),
        tool="tool0",
        guess_kg=2.0,
        rate_hz=100.0,
        joints=JOINTS,
        sensor="motor_current",
        torque={"scale": GAINS_NM_A},
        overlay={
            "robot": {"links_sigma_ratio": 0.2},
            "joints": motor_current(LIMITS_NM, ANGLE_NOISE_RAD),
        },
        runs=[  # payloads: m_load in the scripts of the repository's history
            _run("19_12_23_free"),
            _run("20_01_13-load_2600", 2.602, "19_12_23_free"),
            _run("20_01_31-load", 2.805, "20_01_31-unload"),
            _run("20_01_31-unload"),
            _run("20_02_05-20sec_8harm"),
            _run("20_02_10-30sec_12harm"),
            _run("20_02_12-50sec_12harm"),
            _run("20_02_19_14harm50sec"),
            _run("20_02_19_14harm50secLoad", 2.805, "20_02_19_14harm50sec"),
            _run("20_02_19_15harm50sec", held=True),
            _run("20_02_19_15harm50secLoad", 2.805, "20_02_19_15harm50sec", held=True),
        ],
    ),
)
