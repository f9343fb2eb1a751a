"""Friction of joints: what bearings, seals and cables, and a motor's gear, add to a torque.

    Coulomb    phi = shape(qd)           viscous    phi = qd
    of load    phi = |tau| shape(qd)     tau: torque of the rigid bodies, which the gear transmits

A loaded gear has more friction: where the motor drives the load, it gives (1 + x) tau, and where
the load drives the motor, (1 - x) tau. Without this state, a payload changes the friction that an
empty run has shown. The state needs a held base: elsewhere tau is not known before the residual.

`reversal` gives the shape of Coulomb friction over a window, near tanh(qd / v). At rest its sign is
unknown; the conditioner therefore widens the torque's covariance by the whole prior sigma there.
"""

from functools import partial

import numpy as np

from fsw.config import Config
from fsw.estimators.conditioning import reversal
from fsw.estimators.effects.joint_torque import Basis, JointMotion, Shape, TorqueEffect
from fsw.estimators.model.state_group import (
    Setting,
    Spread,
    StateGroup,
    is_of_current,
    per_joint,
)
from fsw.messages import FloatArray

DRIFT = 0.2  # friction of a gear follows its temperature: some 1 % per kelvin
CAUSE = "friction in the torque sensors"
PER_JOINT = per_joint("friction_load_sigma_ratio")


def _coulomb(setting: Setting) -> Shape:
    speed_rad_s = np.array([joint.friction_speed_rad_s for joint in setting.joints])
    return partial(_reversing, speed_rad_s=speed_rad_s)


def _reversing(motion: JointMotion, speed_rad_s: FloatArray) -> Basis:
    shape, slope = reversal.shape(motion.qd_rad_s, speed_rad_s)
    return Basis(value=shape, by_rate=slope)


def _of_load(setting: Setting) -> Shape:
    return partial(_loaded, reversing=_coulomb(setting))


def _loaded(motion: JointMotion, reversing: Shape) -> Basis:
    if motion.load_nm is None:
        raise ValueError("friction in proportion to the load needs the load")
    basis, load = reversing(motion), motion.load_nm
    size = np.abs(load)
    return Basis(
        value=size * basis.value, by_rate=size * basis.by_rate, by_load=np.sign(load) * basis.value
    )


def _load_prior(setting: Setting) -> Spread:
    return PER_JOINT(setting) if _bears_load(setting.config) else ((), ())


def _bears_load(config: Config) -> bool:
    return config.base.motion == "clamped" and is_of_current(config)


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
        drift=DRIFT,
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
        drift=DRIFT,
        is_free=True,
    ),
    shape=lambda _setting: _proportional,
)
LOAD = TorqueEffect(
    group=StateGroup(
        name="friction_load",
        effect="friction over the load",
        unit="",
        key="joints[].friction_load_sigma_ratio",
        cause=CAUSE,
        prior=_load_prior,
        is_possible=_bears_load,
        is_repeated=True,
        drift=DRIFT,
        is_free=True,
    ),
    shape=_of_load,
    is_of_load=True,
)
