"""The table of all groups of states besides the unknown bodies; its order is that of the state."""

from collections.abc import Callable, Sequence

import numpy as np

from fsw.config import Config
from fsw.estimators.effects import delay, friction, motor_side, wrench_sensor
from fsw.estimators.effects.registered import DEVICES
from fsw.estimators.model import modes
from fsw.estimators.model.state_group import Setting, Spread, StateGroup, per_joint
from fsw.estimators.model.walks import LEAST_RAD2


def _is_unclamped(config: Config) -> bool:
    return config.base.motion != "clamped"


def _integrates(config: Config) -> bool:
    return any(joint.speed_only for joint in config.joints)


LEANS = ("xy", "xz", "yz")  # pairs of a gyro's axes


def _of_imu(key: str, labels: Sequence[str] = "xyz") -> Callable[[Setting], Spread]:
    return lambda setting: (labels, [getattr(setting.config.imu, key)] * len(labels))


def _of_estimator(**labels: Sequence[str]) -> Callable[[Setting], Spread]:
    def prior(setting: Setting) -> Spread:
        own = setting.config.estimator
        sigmas = [getattr(own, key) for key, names in labels.items() for _ in names]
        return [name for names in labels.values() for name in names], sigmas

    return prior


def _zeros(setting: Setting) -> Spread:
    """Return the sigma of every joint's zero [rad], including the walk before the first knot."""
    variance = np.array([joint.zero_sigma_rad for joint in setting.joints]) ** 2
    walks = setting.walks
    if walks is not None:
        variance[walks.joints] += walks.knots_rad2[:, 0] + LEAST_RAD2  # not 0: a zero is a state
    return [joint.name for joint in setting.joints], list(np.sqrt(variance))


def _steps(setting: Setting) -> Spread:
    """Return the label and the sigma [rad] of every step of every random walk."""
    walks = setting.walks
    if walks is None:
        return (), ()
    sigmas, names = np.sqrt(walks.steps_rad2), [joint.name for joint in setting.joints]
    labels = [f"{names[j]}.{k + 1}" for j in walks.joints for k in range(sigmas.shape[1])]
    return labels, sigmas.ravel().tolist()


def _target_wrench(setting: Setting) -> Spread:
    """Return force and moment in inertial axes, then a force in axes E."""
    labels = ("fx", "fy", "fz", "tx", "ty", "tz", "ex", "ey", "ez")
    own = setting.config.estimator
    force, torque = [own.target_force_sigma_n] * 3, [own.target_torque_sigma_nm] * 3
    return labels, force + torque + force


GROUPS = (
    StateGroup(
        name="known",
        effect="errors of known bodies",
        unit="",
        key="robot.links_sigma_ratio",
        cause="inertial data of known bodies and links",
        is_hidden=True,
        is_repeated=True,
        mistake="masses and inertias of the robot's links",
        amount=lambda config: f"{config.robot.links_sigma_ratio:.3g}",
    ),
    StateGroup(
        name="torque_offset",
        effect="torque offsets",
        unit="N m",
        key="joints[].torque_offset_sigma_nm",
        prior=per_joint("torque_offset_sigma_nm"),
        calibrated_from=2.0,
    ),
    StateGroup(
        name="acc_bias",
        effect="bias of accelerometer",
        unit="m/s^2",
        key="imu.acc_bias_sigma_m_s2",
        cause="accelerometer bias",
        prior=_of_imu("acc_bias_sigma_m_s2"),
        calibrated_from=0.3,
    ),
    StateGroup(
        name="gyro_bias",
        effect="bias of gyro",
        unit="rad/s",
        key="imu.gyro_bias_sigma_rad_s",
        cause="gyro bias",
        prior=_of_imu("gyro_bias_sigma_rad_s"),
        calibrated_from=1e-3,
    ),
    StateGroup(
        name="momentum",
        effect="momentum",
        unit="N m s",
        key="estimator.momentum_sigma_nms",
        prior=_of_estimator(momentum_sigma_nms="xyz"),
        is_possible=_is_unclamped,
        is_free=True,
    ),
    StateGroup(
        name="torque_scale",
        effect="torque scales",
        unit="",
        key="joints[].torque_scale_sigma_ratio",
        cause="torque scale",
        prior=per_joint("torque_scale_sigma_ratio"),
        calibrated_from=0.2,
        is_judged=True,
        is_repeated=True,
        shared=0.5,  # one calibration rig for all joints
        mistake="torque_gain of joints",
    ),
    StateGroup(  # force [N] and moment [N m] at the base's origin, inertial axes
        name="wrench",
        effect="constant wrench on the base",
        unit="N, N m",
        key="estimator.external_*",
        cause="external wrench",
        prior=_of_estimator(
            external_force_sigma_n=("fx", "fy", "fz"), external_torque_sigma_nm=("tx", "ty", "tz")
        ),
        is_possible=_is_unclamped,
        is_free=True,
    ),
    StateGroup(  # as `wrench`, at the target's centre of mass; then a force in axes E [N]
        name="target_wrench",
        effect="constant wrench on the target",
        unit="N, N m",
        key="estimator.target_*",
        cause="external wrench",
        prior=_target_wrench,
        is_free=True,
    ),
    StateGroup(  # true angle minus the measured one
        name="joint_zero",
        effect="zeros of joints",
        unit="rad",
        key="joints[].zero_sigma_rad",
        cause="joint zeros",
        prior=_zeros,
        is_calibration=True,
        is_repeated=True,
        mistake="zero_offset_rad of joints",
    ),
    StateGroup(  # true angle, before its zero, over the measured one, minus 1
        name="joint_scale",
        effect="scales of the joints' angles",
        unit="",
        key="joints[].angle_scale_sigma_ratio",
        cause="scales of angles",
        prior=per_joint("angle_scale_sigma_ratio"),
        is_possible=lambda config: not config.modes,
        is_calibration=True,
        is_repeated=True,
    ),
    StateGroup(  # true place minus p_BS_m
        name="imu_place",
        effect="place of the inertial unit",
        unit="m",
        key="imu.mounting_position_sigma_m",
        cause="inertial unit's place",
        prior=_of_imu("mounting_position_sigma_m"),
        calibrated_from=0.3,
        is_calibration=True,
        is_repeated=True,
        doubt=0.01,
        unknown=10.0,
    ),
    StateGroup(  # rotation vector, B axes, from the configured attitude to the true one
        name="imu_angle",
        effect="its attitude",
        unit="rad",
        key="imu.mounting_angle_sigma_rad",
        cause="inertial unit's attitude",
        prior=_of_imu("mounting_angle_sigma_rad"),
        calibrated_from=0.1,
        is_calibration=True,
        is_repeated=True,
        doubt=5e-3,
        unknown=np.pi,
    ),
    StateGroup(  # true rate over the gyro's reading along each axis of the unit, minus 1
        name="gyro_scale",
        effect="scales of the gyro",
        unit="",
        key="imu.gyro_scale_sigma_ratio",
        cause="gyro's scales and axes",
        prior=_of_imu("gyro_scale_sigma_ratio"),
        is_calibration=True,
        is_repeated=True,
    ),
    StateGroup(  # angles by which axes xy, xz, yz of the gyro lean to one another
        name="gyro_axes",
        effect="axes of the gyro that lean",
        unit="rad",
        key="imu.gyro_axes_sigma_rad",
        cause="gyro's scales and axes",
        prior=_of_imu("gyro_axes_sigma_rad", LEANS),
        is_calibration=True,
        is_repeated=True,
        axes=LEANS,
    ),
    friction.COULOMB.group,
    friction.VISCOUS.group,
    *(group for kind in DEVICES for group in kind.groups),
    StateGroup(  # see `Walks`
        name="joint_walk",
        effect="walks of integrated angles",
        unit="rad",
        key="joints[].speed_noise_rad_s",
        cause="joint zeros",
        prior=_steps,
        is_possible=_integrates,
        is_calibration=True,
    ),
    motor_side.ROTOR.group,
    motor_side.RIPPLE.group,
    friction.LOAD.group,
    wrench_sensor.OFFSET,
    wrench_sensor.SCALE,
    *delay.GROUPS,
    *modes.GROUPS,
)
BY_NAME = {group.name: group for group in GROUPS}


def group_of(state: str) -> StateGroup | None:
    """Return the group of a state, such as `torque_offset.joint1`; None: it is of a body."""
    return BY_NAME.get(state.partition(".")[0])


OF_BODIES = {"m": "mass"}
OF_BODIES |= {f"mc{axis}": f"mass times centre of mass {axis}" for axis in "xyz"}
OF_BODIES |= {f"I{axes}": f"inertia {axes}" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")}


def in_words(state: str) -> str:
    """Return the quantity of a state, such as `joint zeros (joint1)` or `mass of target`.

    The name of a group stands for all its states.
    """
    group, (body, _, label) = group_of(state), state.partition(".")
    if group is None:
        return f"{OF_BODIES[label]} of {body}" if label in OF_BODIES else state
    if group.name == "known":  # its labels end in the number of a parameter
        label = label.rpartition(".")[0]
    return (group.cause or group.effect) + f" ({label})" * bool(label)
