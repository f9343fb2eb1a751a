"""From a configuration to the estimation problem: priors, order of joints, layout of the state."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from fsw.config import BaseConfig, BodyConfig, Config, JointConfig
from fsw.errors import ConfigError
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.effects.delay import delays
from fsw.estimators.effects.joint_torque import terms_of
from fsw.estimators.effects.registered import TORQUE_EFFECTS, carrier, switched
from fsw.estimators.effects.wrench_sensor import sensors_of
from fsw.estimators.model.calibration import known_bodies
from fsw.estimators.model.inertia import (
    NAMES,
    PARAMETERS,
    report_jacobian,
    to_parameters,
)
from fsw.estimators.model.modes import with_modes
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.problem import Problem, Watched
from fsw.estimators.model.robot import Hold, RobotModel
from fsw.estimators.model.state_group import Setting
from fsw.estimators.model.state_groups import GROUPS
from fsw.estimators.model.walks import walks_of
from fsw.estimators.noise.fading import covariance_at_nodes
from fsw.messages import Block, FloatArray

S = TypeVar("S", bound=BaseModel)
NOISY_RAD = 2e-7  # errors of angles above it are seen in the channels, besides those of rates
NOTHING_EXACT = 1e-3  # sigma of what is watched; any positive value gives the same columns


def body_prior(body: BodyConfig) -> tuple[FloatArray, FloatArray]:
    """Return prior mean (10,) and covariance (10, 10) of pi from mass, com, inertia and sigmas.

    The sigmas are propagated to first order at the mean; without sigmas the covariance is zero.
    """
    mean = to_parameters(body.mass_kg, np.array(body.com_m), np.array(body.inertia_kg_m2))
    if body.sigma is None:
        return mean, np.zeros((PARAMETERS, PARAMETERS))
    sigma = np.concatenate(([body.sigma.mass_kg], body.sigma.com_m, body.sigma.inertia_kg_m2))
    root = np.linalg.solve(report_jacobian(mean), np.diag(sigma))
    return mean, root @ root.T


def base_freedom(base: BaseConfig) -> FloatArray:
    """Return (6, k): the free motions [v_b, w_b] of the base in B, orthonormal columns.

    All six are free in space. On an air-bearing table two along the table and one about its normal
    are free, and they are fixed in B. On a bench none is free.
    """
    if base.motion == "free":
        return np.eye(6)
    if base.motion == "clamped":
        return np.zeros((6, 0))
    normal = np.array(base.normal_B)
    along = np.linalg.svd(normal[None])[2][1:].T  # (3, 2)
    freedom = np.zeros((6, 3))
    freedom[:3, :2], freedom[3:, 2] = along, normal
    return freedom


def liquid_root(body: BodyConfig) -> FloatArray:
    """Return (10, k): changes of a body's apparent pi by its liquid, one column per change.

    A motion faster than the liquid's own leaves the liquid behind, and the body appears without it.
    A slow motion carries the liquid along. The liquid may also be anywhere within its stroke. The
    data do not show which of these is the case until the liquid comes back.
    """
    ways = []
    for part in body.liquid:
        place, still = np.array(part.place_m), np.zeros(6)
        whole = to_parameters(part.mass_kg, place, still)
        moved = [place + step for step in part.stroke_m * np.eye(3)]
        ways += [whole, *(to_parameters(part.mass_kg, at, still) - whole for at in moved)]
    return np.array(ways).reshape(-1, PARAMETERS).T


def joint_order(config: Config, model: RobotModel) -> tuple[int, ...]:
    """Return, for every joint of the model, its index in the configured joint list.

    Raises
    ------
    ConfigError if the two sets of names differ, or the kind of a joint differs from the URDF's.
    """
    configured = [joint.name for joint in config.joints]
    if sorted(configured) != sorted(model.joint_names):
        raise ConfigError(
            f"joints: names {configured} must be the {model.n} joints of the robot "
            f"{list(model.joint_names)}"
        )
    order = tuple(configured.index(name) for name in model.joint_names)
    for k, kind in zip(order, model.kinds(), strict=True):
        if config.joints[k].kind != kind:
            raise ConfigError(
                f"joints.{k}.kind: {config.joints[k].kind!r}; {configured[k]!r} is {kind} in the "
                "URDF"
            )
    return order


def robot_of(config: Config, text: str | None = None) -> RobotModel:
    """Return the robot of a configuration, with its wrench sensors; `text` replaces the URDF file.

    Raises
    ------
    ConfigError if the robot cannot be read or has no frame of that name.
    """
    own, urdf = config.robot, config.resolve(config.robot.urdf)
    return RobotModel(urdf, own.tool_frame, text, sensors_of(config))


def torque_samples(config: Config, order: Sequence[int]) -> NDArray[np.int64]:
    """Return the number of samples (t,) in a window: joints in the model's order, then axes."""
    rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
    every_hz = [rates_hz[config.joints[k].bus] for k in order]
    every_hz += [sensor.rate_hz for sensor in config.wrench_sensors for _ in sensor.noise]
    samples = [max(1, round(config.estimator.window_s * rate_hz)) for rate_hz in every_hz]
    return np.array(samples, np.int64)


def imu_samples(config: Config) -> int:
    """Return the number of samples of the inertial unit in a window, at least one."""
    return max(1, round(config.estimator.window_s * config.imu.rate_hz))


def torque_model_covariance(config: Config, order: Sequence[int]) -> FloatArray:
    """Return the covariance (t, m, m) at nodes of the torques that the model leaves out [N^2 m^2].

    Joints are in the model's order, then the axes of wrench sensors; the covariance is zero where
    torque_model_sigma_nm is zero, and for an axis.
    """
    window_s, m = config.estimator.window_s, config.estimator.nodes
    every = torque_samples(config, order)
    covariance = np.zeros((len(every), m, m))
    for k, samples in enumerate(every[: len(order)].tolist()):
        joint = config.joints[order[k]]
        if joint.torque_model_sigma_nm > 0.0:
            fading = float(np.exp(-window_s / samples / joint.torque_model_correlation_s))
            at_nodes = covariance_at_nodes(samples, m, fading)
            covariance[k] = joint.torque_model_sigma_nm**2 * at_nodes
    return covariance


def ordered(bodies: Sequence[str]) -> tuple[str, ...]:
    """Return bodies in the order of the state: base, target, then the others in the given order."""
    first = [name for name in ("base", "target") if name in bodies]
    return (*first, *(name for name in bodies if name not in first))


def holds(config: Config, model: RobotModel, unknown: tuple[str, ...]) -> dict[str, Hold]:
    """Return by name how each body but the base hangs on the robot.

    Raises
    ------
    ConfigError if the robot has no such frame, or two unknown bodies are fixed to one another.
    """
    held = {
        name: model.tool if body.frame is None else model.hold(body.frame, f"bodies.{name}.frame")
        for name, body in config.bodies.items()
        if name != "base"
    }
    owners: dict[int, str] = {}
    for name in unknown:
        place = held[name].body if name in held else 0
        if place in owners:
            raise ConfigError(
                f"unknown: {owners[place]!r} and {name!r} are fixed to one another; only their sum "
                "can be found"
            )
        owners[place] = name
    return held


def build_problem(
    config: Config, model: RobotModel, *, exact: bool = False, blocks: Sequence[Block] = ()
) -> Problem:
    """Return the problem of one configuration: layout and prior of the state.

    `exact`: known bodies, zeros of the joints and the inertial unit's mounting are as configured.
    `blocks`: the random walks of integrated angles cover these blocks; if empty, see `walks_of`.
    Where the likelihood of a free robot is judged and a sensor is exact, what creeps is watched.

    Raises
    ------
    ConfigError if the joints do not match the robot's.
    """
    problem = _problem_of(config, model, exact, blocks)
    if exact or config.modes or not problem.is_free or config.estimator.is_regression:
        return problem
    doubted = _problem_of(_in_doubt(config), model, exact, blocks)
    columns, one = dict[str, FloatArray](), np.eye(len(doubted.names))
    for group in GROUPS:
        own = (
            range(*doubted.at(group.name).indices(len(one))) if group.is_constant_of_sensor else ()
        )
        columns |= {doubted.names[k]: one[k] for k in own}
        if len(own) > 1:
            columns[group.name] = one[own].sum(axis=0)
    if all(name in problem.names or "." not in name for name in columns):
        return problem
    watched = Watched(doubted, tuple(columns), np.stack(list(columns.values()), axis=1))
    return replace(problem, watched=watched)


def _in_doubt(config: Config) -> Config:
    """Return the configuration with no constant of joints or inertial unit exact."""
    joints, imu = dict[str, float](), dict[str, float]()
    for group in GROUPS:
        if group.is_constant_of_sensor and group.applies_to(config):
            own = joints if group.section == "joints" else imu
            own[group.field] = NOTHING_EXACT
    return config.model_copy(
        update={
            "joints": tuple(_doubted(joint, joints) for joint in config.joints),
            "imu": _doubted(config.imu, imu),
        }
    )


def _doubted(section: S, sigmas: Mapping[str, float]) -> S:
    """Return a section with sigmas where it has none."""
    absent = {key: sigma for key, sigma in sigmas.items() if getattr(section, key) == 0.0}
    return section.model_copy(update=absent)


def _angle_is_noisy(joint: JointConfig) -> bool:
    moved_rad = joint.stamp_sigma_s * joint.speed_limit_rad_s
    return joint.speed_only or bool(np.hypot(joint.position_noise_rad, moved_rad) > NOISY_RAD)


def _problem_of(config: Config, model: RobotModel, exact: bool, blocks: Sequence[Block]) -> Problem:
    joints = [config.joints[k] for k in joint_order(config, model)]
    walks = walks_of(config, joint_order(config, model), blocks)
    unknown = ordered(config.unknown)
    held = holds(config, model, unknown)
    pi_base = model.pi_links[:PARAMETERS]
    if "base" in config.bodies:
        pi_base = body_prior(config.bodies["base"])[0]
    pi_target = body_prior(config.bodies["target"])[0] if "target" in config.bodies else None
    pi_known = model.total_parameters(
        np.zeros(PARAMETERS) if "base" in unknown else pi_base,
        None if "target" in unknown else pi_target,
    )
    for name, hold in held.items():
        if name != "target" and name not in unknown:
            pi_known[hold.places] += hold.map @ body_prior(config.bodies[name])[0]
    U = np.zeros((pi_known.size, PARAMETERS * len(unknown)))
    known = {} if exact else dict(known_bodies(config, model, unknown, held))
    means, covariances, names, liquids = [], [], [], []
    for index, name in enumerate(unknown):
        columns = slice(PARAMETERS * index, PARAMETERS * (index + 1))
        if name == "base":
            U[:PARAMETERS, columns] = np.eye(PARAMETERS)
        else:
            U[held[name].places, columns] = held[name].map
        mean, covariance = body_prior(config.bodies[name])
        means.append(mean)
        covariances.append(covariance)
        liquids.append(liquid_root(config.bodies[name]))
        names += [f"{name}.{parameter}" for parameter in NAMES]
    for place, ways in known.items():
        U = np.concatenate([U, ways], axis=1)
        means.append(np.zeros(ways.shape[1]))
        covariances.append(np.eye(ways.shape[1]))
        names += [f"known.{place}.{k + 1}" for k in range(ways.shape[1])]
    setting, places = Setting(config=config, joints=joints, walks=walks), dict[str, slice]()
    for group in GROUPS:
        labels, sigmas = group.prior(setting)
        if not any(sigmas) or (exact and group.is_calibration):
            continue
        places[group.name] = slice(len(names), len(names) + len(sigmas))
        names += [f"{group.name}.{label}" for label in labels]
        means.append(np.zeros(len(sigmas)))
        spread, own = np.maximum(sigmas, 1e-9), 1.0 - group.shared
        covariances.append(np.diag(own * spread**2) + group.shared * np.outer(spread, spread))
    imu, estimator = config.imu, config.estimator
    prior_covariance = np.zeros((len(names), len(names)))
    start = 0
    for block in covariances:
        stop = start + len(block)
        prior_covariance[start:stop, start:stop] = block
        start = stop
    liquid = np.zeros_like(prior_covariance)
    for index, root in enumerate(liquids):
        k = slice(PARAMETERS * index, PARAMETERS * (index + 1))
        liquid[k, k] = root @ root.T
    problem = Problem(
        model=model,
        unknown=unknown,
        pi_known=pi_known,
        U=U,
        names=tuple(names),
        prior_mean=np.concatenate(means),
        prior_covariance=prior_covariance,
        places=places,
        carrier=carrier(config, places),
        walks=walks if "joint_walk" in places else None,
        switched=switched(config, places),
        delays=delays(setting, places, len(model.torque_units)),
        torque_terms=terms_of(TORQUE_EFFECTS, setting, places),
        of_current=np.array([joint.torque == "motor_current" for joint in joints], np.bool_),
        target_com_m=np.array(
            config.bodies["target"].com_m if "target" in config.bodies else np.zeros(3)
        ),
        p_BS_m=np.array(imu.mounting.p_BS_m),
        R_BS=rotation_from_xyzw(np.array(imu.mounting.q_BS_xyzw)),
        orbit=CircularOrbit.from_config(config.orbit) if config.orbit is not None else None,
        angles_are_noisy=any(_angle_is_noisy(joint) for joint in joints),
        window_s=estimator.window_s,
        nodes=estimator.nodes,
        noise_declared=np.array(
            [
                *(j.torque_noise_nm for j in joints),
                *(sigma for sensor in config.wrench_sensors for sigma in sensor.noise),
                imu.angle_random_walk_rad_sqrt_s * imu.rate_hz**0.5,
                imu.velocity_random_walk_m_s_sqrt_s * imu.rate_hz**0.5,
            ]
        ),
        noise_samples=np.concatenate(
            [torque_samples(config, joint_order(config, model)), [imu_samples(config)] * 2]
        ),
        torque_model_nm2=torque_model_covariance(config, joint_order(config, model)),
        wrench_sigma=np.repeat(
            [estimator.wrench_force_sigma_n, estimator.wrench_torque_sigma_nm], 3
        ),
        freedom=base_freedom(config.base),
        support_m_s2=-np.array(config.base.gravity_B_m_s2),
        watches_outside=estimator.outside_wrench == "watch",
        liquid=liquid,
    )
    return with_modes(problem, config.modes) if config.modes else problem
