"""Joint nodes: sign, zero, gain and offset of their values."""

from collections.abc import Sequence
from math import tau

import numpy as np

from fsw.config import JointConfig
from fsw.messages import FloatArray, IntArray


class Calibration:
    """Calibration of joints: sign and zero offset of positions; gain and offset of torques.

    Parameters
    ----------
    on_wire : positions are those of a node, where a revolution of a prismatic joint is a metre;
        False: they are metres
    """

    def __init__(self, joints: Sequence[JointConfig], *, on_wire: bool = True) -> None:
        turned = [on_wire and joint.kind == "prismatic" for joint in joints]
        units = [1.0 / tau if is_turned else 1.0 for is_turned in turned]
        self._sign = np.array([joint.sign for joint in joints]) * units
        self._zero_rad = np.array([joint.zero_offset_rad for joint in joints])  # 0 for a speed
        self._gain = np.array([joint.sign * joint.torque_gain for joint in joints], float)
        self._offset_nm = np.array([joint.torque_offset_nm for joint in joints])

    def apply(
        self, joint: IntArray, position_rad: FloatArray, torque_nm: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return calibrated positions (or speeds) and torques, in zero and sign of the URDF.

        position = sign x raw - zero_offset; torque = sign x gain x raw - offset. `joint` (k,) is
        the place of each value's joint in the list given to the constructor.
        """
        return (
            self._sign[joint] * position_rad - self._zero_rad[joint],
            self._gain[joint] * torque_nm - self._offset_nm[joint],
        )

    def rate(self, joint: int, rate_rad_s: float) -> float:
        """Return the rate of one joint in its configured sign [rad/s, or m/s if prismatic]."""
        return float(self._sign[joint] * rate_rad_s)
