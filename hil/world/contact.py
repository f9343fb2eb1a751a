"""A contact: for a time, a soft spring and damper hold the target to a fixture at rest in N."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from pydantic import ConfigDict
from scipy.spatial.transform import Rotation

from hil.world.robot import TARGET


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """From `from_s` to `to_s` the target is held at the pose that it has at `from_s`."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    from_s: float
    to_s: float
    stiffness_n_m: float
    damping_n_s_m: float
    turn_stiffness_nm_rad: float
    turn_damping_nms_rad: float


class Fixture:
    """A contact as the wrench of one simulation, which calls it at increasing times."""

    def __init__(self, contact: Contact) -> None:
        self._contact = contact
        self._place: tuple[np.ndarray, Rotation] | None = None

    def __call__(self, t_s: float, data: mujoco.MjData) -> None:
        """Add force and torque at the target's centre of mass to data.xfrc_applied."""
        own = self._contact
        if not own.from_s <= t_s < own.to_s:
            return
        target = data.body(TARGET)
        turned = Rotation.from_matrix(target.ximat.reshape(3, 3))
        if self._place is None:
            self._place = target.xipos.copy(), turned
        place, attitude = self._place
        rate = np.zeros(6)  # about the centre of mass, in N: rotation, then translation
        body = mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(data.model, data, body, target.id, rate, 0)
        moved = target.xipos - place
        angle = (turned * attitude.inv()).as_rotvec()
        applied: Any = data.xfrc_applied[target.id]
        applied[:3] -= own.stiffness_n_m * moved + own.damping_n_s_m * rate[3:]
        applied[3:] -= own.turn_stiffness_nm_rad * angle + own.turn_damping_nms_rad * rate[:3]
