"""The sense of the star tracker's quaternion, found beside the gyro, with the value to set."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.config import load
from fsw.messages import ChannelWindow
from offline.checks.recorded import tracker_findings

RATE_RAD_S = np.array([0.02, -0.03, 0.05])


def channel(t_s: np.ndarray, values: np.ndarray) -> ChannelWindow:
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    return ChannelWindow(t_ns=t_ns, values=values, missing=False, stale=False)


@pytest.mark.parametrize(
    ("declared", "right"),
    [
        ("inertial_to_tracker", "tracker_to_inertial"),
        ("tracker_to_inertial", "inertial_to_tracker"),
    ],
)
def test_a_quaternion_that_turns_the_other_way_names_the_value_to_set(arm, declared, right):
    arm.data["star_tracker"]["rotation"] = declared
    config = load(arm.write())
    R_BS = Rotation.from_quat(config.imu.mounting.q_BS_xyzw)
    q_BT = Rotation.from_quat(config.star_tracker.mounting.q_BS_xyzw)
    t_s = np.arange(0.0, 20.0, 0.01)
    gyro = channel(t_s, np.tile(R_BS.inv().apply(RATE_RAD_S), (len(t_s), 1)))
    slow = t_s[::20]
    R_NB = Rotation.from_rotvec(slow[:, None] * RATE_RAD_S)
    for way, expected in ((R_NB, []), ((R_NB * q_BT).inv() * q_BT.inv(), [right])):
        window = SimpleNamespace(index=0, gyro=gyro, attitude=channel(slow, way.as_quat()))
        found = tracker_findings(config, [cast(Any, window)])
        assert [own.partition(";")[2].split(" (")[0] for own in found] == [
            f" set it to {own}" for own in expected
        ]
