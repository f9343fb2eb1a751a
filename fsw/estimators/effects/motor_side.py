"""What stands between a motor's current and its link: the rotor's inertia, and the gear's ripple.

    rotor inertia   phi = qdd               I_r: of rotor and gear about the joint's axis, times the
                                            gear ratio squared
    ripple          phi = sin(k q), cos(k q)     k periods in a turn of the joint

The rotor's spin about its own axis in a moving base is left out: it is I_r over the gear ratio.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from fsw.estimators.effects.friction import DRIFT
from fsw.estimators.effects.joint_torque import Basis, JointMotion, Shape, TorqueEffect
from fsw.estimators.model.state_group import (
    Setting,
    Spread,
    StateGroup,
    is_of_current,
    per_joint,
)
from fsw.messages import FloatArray, IntArray


def _accelerated(motion: JointMotion) -> Basis:
    return Basis(value=motion.qdd_rad_s2, by_acceleration=np.ones_like(motion.qdd_rad_s2))


def _waves(setting: Setting) -> list[tuple[int, float]]:
    """Return joint and number of periods in a turn of every declared ripple."""
    return [(k, n) for k, joint in enumerate(setting.joints) for n in joint.ripple_periods]


def _amplitudes(setting: Setting) -> Spread:
    labels, sigmas = list[str](), list[float]()
    for k, periods in _waves(setting):
        joint = setting.joints[k]
        labels += [f"{joint.name}.{periods:g}.{part}" for part in ("sin", "cos")]
        sigmas += [joint.ripple_sigma_nm] * 2
    return labels, sigmas


def _rippling(motion: JointMotion, joints: IntArray, periods: FloatArray) -> Basis:
    phase = periods * motion.q_rad[..., joints]
    phase[..., 1::2] += 0.5 * np.pi
    return Basis(value=np.sin(phase), by_angle=periods * np.cos(phase))


def _ripple(setting: Setting) -> Shape:
    periods = np.repeat([n for _, n in _waves(setting)], 2)
    return partial(_rippling, joints=np.array(_rippled(setting), np.intp), periods=periods)


def _rippled(setting: Setting) -> Sequence[int]:
    return [k for k, _ in _waves(setting) for _ in range(2)]


ROTOR = TorqueEffect(
    group=StateGroup(
        name="rotor_inertia",
        effect="inertia of rotors",
        unit="kg m^2",
        key="joints[].rotor_inertia_sigma_kg_m2",
        prior=per_joint("rotor_inertia_sigma_kg_m2"),
        is_possible=is_of_current,
        is_repeated=True,
        is_free=True,
    ),
    shape=lambda _setting: _accelerated,
)
RIPPLE = TorqueEffect(
    group=StateGroup(
        name="ripple",
        effect="ripple of gears",
        unit="N m",
        key="joints[].ripple_sigma_nm",
        prior=_amplitudes,
        is_possible=is_of_current,
        is_hidden=True,
        is_repeated=True,
        drift=DRIFT,
        is_free=True,
    ),
    shape=_ripple,
    joints=_rippled,
)
