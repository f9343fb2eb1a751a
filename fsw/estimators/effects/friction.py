"""Friction of joints: what bearings, seals and cables, and a motor's gear, add to a torque.

    Coulomb    phi = shape(qd)           viscous    phi = qd

`reversal` gives the shape of Coulomb friction over a window, near tanh(qd / v). At rest its sign is
unknown; the conditioner therefore widens the torque's covariance by the whole prior sigma there.
"""

from functools import partial

import numpy as np

from fsw.estimators import reversal
from fsw.estimators.effects.joint_torque import Basis, JointMotion, Shape, TorqueEffect
from fsw.estimators.model.state_group import Setting, StateGroup, per_joint
from fsw.messages import FloatArray

CAUSE = "friction in the torque sensors"


def _coulomb(setting: Setting) -> Shape:
    speed_rad_s = np.array([joint.friction_speed_rad_s for joint in setting.joints])
    return partial(_reversing, speed_rad_s=speed_rad_s)


def _reversing(motion: JointMotion, speed_rad_s: FloatArray) -> Basis:
    shape, slope = reversal.shape(motion.qd_rad_s, speed_rad_s)
    return Basis(value=shape, by_rate=slope)


def _proportional(motion: JointMotion) -> Basis:
    return Basis(value=motion.qd_rad_s, by_rate=np.ones_like(motion.qd_rad_s))


COULOMB = TorqueEffect(
    group=StateGroup(
        name="friction_coulomb",
        effect="Coulomb friction",
        unit="N m",
        key="joints[].friction_coulomb_sigma_nm",
        cause=CAUSE,
        prior=per_joint("friction_coulomb_sigma_nm"),
        is_repeated=True,
        is_free=True,
    ),
    shape=_coulomb,
)
VISCOUS = TorqueEffect(
    group=StateGroup(
        name="friction_viscous",
        effect="viscous friction",
        unit="N m s/rad",
        key="joints[].friction_viscous_sigma_nms_rad",
        cause=CAUSE,
        prior=per_joint("friction_viscous_sigma_nms_rad"),
        is_repeated=True,
        is_free=True,
    ),
    shape=lambda _setting: _proportional,
)
