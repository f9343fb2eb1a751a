"""The estimation problem: which parameters are unknown, their prior, and the state's layout.

State x = [10 parameters per unknown body (base first, then target), ways in which the known bodies
may differ (up to 10 each), torque offsets (n), accelerometer bias (3), gyro bias (3), residual
angular momentum (3), torque scale errors (n), external wrench (6), wrench on the target (9), zeros
of the joints (n), place (3) and angles (3) of the inertial unit, Coulomb and viscous friction of
the joints (n each), relative errors of the wheels' inertias and errors of their delays (k each), of
K thrusters relative errors of the forces, errors of the delays and of the rise times, steps of the
walks of integrated angles, and what `modes` appends]. Where a prior sigma is zero there is no
state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsw.config import BaseConfig, BodyConfig, Config, JointConfig
from fsw.estimators.fading_noise import covariance_at_nodes
from fsw.estimators.model.calibration import known_bodies
from fsw.estimators.model.inertia import (
    NAMES,
    PARAMETERS,
    consistent_state,
    report_jacobian,
    to_parameters,
)
from fsw.estimators.model.modes import Modes, with_modes
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.robot import Hold, RobotModel
from fsw.estimators.model.walks import LEAST_RAD2, Walks, walks_of
from fsw.messages import Block, FloatArray
from fsw.messages.errors import ConfigError

NO_STATES = slice(0, 0)
MODE_REACH = 3.0  # sigmas of a mode's prior within which it is linearised
IMPLAUSIBLE = 10.0  # sigmas of a value of arm or calibration that its prior cannot be meant for
CONSPICUOUS = 4.0  # the same, to be named
SHARED_SCALE = 0.5  # share of the torque scales' variance that all joints have in common: one rig
SHARED = ("torque_scale", "thrust_scale")  # and of the thrusters' forces: one pressure
TAIL_RISES = 10.0  # rise times after which a force has settled
THRUST = ("thrust_scale", "thrust_delay", "thrust_rise")
CALIBRATION = (
    *("joint_zero", "joint_walk", "imu_place", "imu_angle", "wheel_scale", "wheel_delay"),
    *THRUST,
)
IndexArray = NDArray[np.intp]


def no_states() -> slice:
    """Return the place of a nuisance that is not part of the state."""
    return slice(0, 0)


def present(states: slice) -> bool:
    """Return whether a nuisance is part of the state."""
    return bool(states.stop > states.start)


@dataclass(frozen=True, slots=True, eq=False)
class Thrusters:
    """Configured forces and delays of K thrusters."""

    ways: FloatArray  # (6, K) nominal force and its moment about the base's origin, base axes
    delay_s: FloatArray  # (K,)
    rise_s: FloatArray

    def __len__(self) -> int:
        """Return the number of thrusters."""
        return len(self.delay_s)

    @property
    def tail_s(self) -> FloatArray:
        """Return after which time (K,) a change of the valve is a settled force."""
        tail_s: FloatArray = self.delay_s + TAIL_RISES * self.rise_s
        return tail_s

    @staticmethod
    def of(config: Config) -> Thrusters:
        """Return those of a configuration."""
        own = config.thrusters
        force = np.array([t.force_n * np.array(t.direction_B) for t in own]).reshape(-1, 3)
        place = np.array([t.p_B_m for t in own]).reshape(-1, 3)
        ways = np.concatenate([force, np.cross(place, force)], axis=1).T
        times = np.array([(t.delay_s, t.rise_s) for t in own]).reshape(-1, 2)
        return Thrusters(ways, times[:, 0], times[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Everything the measurement functions need besides the data.

    `pi_known` (10 (n+1),) holds the known bodies with zeros (or the link alone) where an unknown
    one goes; `U` (10 (n+1), k) maps the k inertial states (unknown bodies, then known) into it, so
    that pi = pi_known + U x[:k]. Sensor geometry in base axes.
    """

    model: RobotModel
    unknown: tuple[str, ...]
    pi_known: FloatArray
    U: FloatArray
    names: tuple[str, ...]
    prior_mean: FloatArray
    prior_covariance: FloatArray
    torque_offset: slice
    acc_bias: slice
    gyro_bias: slice
    momentum: slice
    torque_scale: slice
    wrench: slice  # force [N] and moment [N m] at the base's origin, inertial axes
    joint_zero: slice  # true angle less the measured one [rad]
    imu_place: slice  # true place less p_BS_m [m]
    imu_angle: slice  # rotation vector, B axes, from the configured attitude to the true one [rad]
    friction_coulomb: slice  # of each joint, as its torque sensor sees it [N m]
    friction_viscous: slice  # [N m s/rad]
    wheel_scale: slice  # relative error of each wheel's axial inertia
    wheel_delay: slice  # true delay less the configured one [s]
    wheel_axes: FloatArray  # (3, k) of the reaction wheels, in B
    thrust_scale: slice  # relative error of each thruster's force
    thrust_delay: slice  # true delay less the configured one [s]
    thrust_rise: slice  # true rise time less the configured one [s]
    thrusters: Thrusters
    friction_speed_rad_s: FloatArray  # (n,) rate at which Coulomb friction has built up: tanh(1)
    target_wrench: slice  # the same at the target's centre of mass, then a force in axes E [N]
    target_com_m: FloatArray  # (3,) in E, as configured: where that acts on a known target
    p_BS_m: FloatArray  # accelerometer's place
    orbit: CircularOrbit | None  # None: no gravity gradient
    window_s: float
    nodes: int  # of a block
    noise_declared: FloatArray  # (n + 2,) 1 sigma of a sample: torques, gyro, accelerometer
    noise_samples: NDArray[np.int64]  # (n + 2,) of a window
    torque_model_nm2: FloatArray  # (n, m, m) covariance of what the model leaves out, at the nodes
    wrench_sigma: FloatArray  # (6,) unmodelled external wrench, per node
    freedom: FloatArray  # (6, k) motions [v_b, w_b] that nothing holds the base from, orthonormal
    support_m_s2: FloatArray  # (3,) acceleration by which what holds the base keeps it from falling
    watches_outside: bool  # whether blocks may be marked as those of an unknown momentum
    liquid: FloatArray  # (p, p) covariance that liquid in the bodies adds to what is published
    mode_mass: slice = field(
        default_factory=no_states
    )  # relative error of the inertia of each of the base's modes
    mode_frequency: slice = field(
        default_factory=no_states
    )  # logarithm of the factor on what is configured
    mode_damping: slice = field(default_factory=no_states)
    mode_start: slice = field(
        default_factory=no_states
    )  # coordinates, then rates, where the data begin [m or rad]
    joint_walk: slice = field(default_factory=no_states)  # see `Walks` [rad]
    walks: Walks | None = None  # None: no encoder gives speed only
    modes: Modes | None = None  # None: none, or the robot of this problem has them as joints

    @property
    def is_free(self) -> bool:
        """Whether nothing holds the base."""
        return bool(self.freedom.shape[1] == self.freedom.shape[0])

    @property
    def bodies(self) -> slice:
        """Return the states that are body parameters."""
        return slice(0, PARAMETERS * len(self.unknown))

    @property
    def shown(self) -> IndexArray:
        """Return the body parameters that a motion can show: without joints not the mass.

        A body that no force is known of moves alike whatever its mass, if its centre of mass and
        its inertia about that are the same.
        """
        every = np.arange(self.bodies.stop)
        return every if self.model.n else every[every % PARAMETERS > 0]

    @property
    def inertial(self) -> slice | IndexArray:
        """Return the states that are inertial data, of unknown bodies and of known ones.

        Where the robot has modes as joints, their masses too.
        """
        own, count = self.U.shape[1], self.mode_mass.stop - self.mode_mass.start
        if count == 0 or self.modes is not None:
            return slice(0, own)
        return np.concatenate([np.arange(own - count), np.arange(len(self.names))[self.mode_mass]])

    @property
    def prior(self) -> Prior:
        """Return what is known before the data."""
        return self.prior_of(self.prior_mean, self.prior_covariance)

    def prior_of(self, mean: FloatArray, covariance: FloatArray) -> Prior:
        """Return a prior of another mean (p,) and covariance (p, p)."""
        return Prior(mean, covariance, tuple(self.body(name) for name in self.unknown))

    @property
    def known(self) -> slice:
        """Return the states by which known bodies may differ."""
        first = self.bodies.stop
        return slice(first, first + sum(name.startswith("known.") for name in self.names))

    @property
    def published(self) -> IndexArray:
        """Return the states that are published: not the known bodies, zeros and mounting."""
        hidden = (
            self.known,
            *(self.joint_zero, self.joint_walk, self.imu_place, self.imu_angle),
            *(self.wheel_scale, self.wheel_delay),
            *(self.thrust_scale, self.thrust_delay, self.thrust_rise, self.mode_start),
        )
        return np.delete(np.arange(len(self.names)), np.r_[hidden])

    def least_plausible(self, x: FloatArray) -> tuple[str, float]:
        """Return which value of arm and calibration is farthest from its prior, and its sigmas."""
        doubts = np.setdiff1d(np.arange(len(x)), self.published)
        told = (self.torque_scale, self.mode_mass, self.mode_frequency, self.mode_damping)
        doubts = np.concatenate([doubts, *(np.arange(len(x))[states] for states in told)])
        if not len(doubts):
            return "", 0.0
        sigmas = np.abs((x - self.prior_mean)[doubts]) / np.sqrt(
            np.diag(self.prior_covariance)[doubts]
        )
        worst = int(np.argmax(sigmas))
        return self.names[doubts[worst]], float(sigmas[worst])

    def suspicion(self, x: FloatArray) -> str:
        """Return words for the value of arm and calibration that looks wrong; empty: none does."""
        name, sigmas = self.least_plausible(x)
        return f"; {name} is {sigmas:.0f} sigma off" if sigmas > CONSPICUOUS else ""

    def place_m(self, x: FloatArray) -> FloatArray:
        """Return where the accelerometer is (3,) for the state x."""
        return self.p_BS_m + x[self.imu_place] if present(self.imu_place) else self.p_BS_m

    def body(self, name: str) -> slice:
        """Return the ten states of one unknown body."""
        start = PARAMETERS * self.unknown.index(name)
        return slice(start, start + PARAMETERS)

    def consistent(self, x: FloatArray, covariance: Callable[[], FloatArray]) -> FloatArray:
        """Return a state (p,) with each body moved to the nearest consistent one, modes to theirs.

        A mode is at most MODE_REACH sigma from its prior, and the base is more than its modes.
        `covariance` returns that of the state (p, p).
        """
        off = np.zeros(len(x))
        if self.modes is not None:
            k = np.r_[self.mode_mass, self.mode_frequency, self.mode_damping]
            reach = MODE_REACH * np.sqrt(np.diag(self.prior_covariance)[k])
            if np.any(np.abs(x[k]) > reach):
                x = x.copy()
                x[k] = np.clip(x[k], -reach, reach)
            if "base" in self.unknown:
                own = self.body("base")
                off[own] = x[own] - self.modes.released.pi(x)[:PARAMETERS]
        bodies = [self.body(name) for name in self.unknown]
        return consistent_state(x, bodies, covariance, off)

    def pi(self, x: FloatArray) -> FloatArray:
        """Return the parameters of base and links (10 (n+1),) for the state x."""
        return self.pi_known + self.U @ x[self.inertial]


def body_prior(body: BodyConfig) -> tuple[FloatArray, FloatArray]:
    """Return prior mean (10,) and covariance (10, 10) of pi from mass, com, inertia and sigmas.

    First-order propagation through the exact map at the mean.
    """
    mean = to_parameters(body.mass_kg, np.array(body.com_m), np.array(body.inertia_kg_m2))
    if body.sigma is None:
        return mean, np.zeros((PARAMETERS, PARAMETERS))
    sigma = np.concatenate(([body.sigma.mass_kg], body.sigma.com_m, body.sigma.inertia_kg_m2))
    root = np.linalg.solve(report_jacobian(mean), np.diag(sigma))
    return mean, root @ root.T


def base_freedom(base: BaseConfig) -> FloatArray:
    """Return (6, k): the motions of the base that are free, in its own axes.

    All six in space; on an air-bearing table two along it and one about its normal, which stand
    still in the base's axes; none on a bench.
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
    """Return (10, k): by how much liquid may change the apparent body, a column per way.

    A motion faster than the liquid's own leaves it behind, and the body appears without it; a slow
    one takes it along; and it may be anywhere within its stroke. Nothing in the data tells which,
    until the liquid comes back.
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
    ConfigError if the two sets of names differ, or a joint is of another kind than the robot's.
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


def torque_samples(config: Config, order: Sequence[int]) -> NDArray[np.int64]:
    """Return how many samples of each joint (n,) a window has, in the model's order."""
    rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
    buses = [config.joints[k].bus for k in order]
    samples = [round(config.estimator.window_s * rates_hz[bus]) for bus in buses]
    return np.array(samples, np.int64)


def imu_samples(config: Config) -> int:
    """Return how many samples of the inertial unit a window has, one at least."""
    return max(1, round(config.estimator.window_s * config.imu.rate_hz))


def torque_model_covariance(config: Config, order: Sequence[int]) -> FloatArray:
    """Return the covariance (n, m, m) at nodes of what the model leaves out of torques [N^2 m^2].

    In the model's order; zero where a joint's torque_model_sigma_nm is.
    """
    window_s, m = config.estimator.window_s, config.estimator.nodes
    covariance = np.zeros((len(order), m, m))
    for k, samples in enumerate(torque_samples(config, order).tolist()):
        joint = config.joints[order[k]]
        if joint.torque_model_sigma_nm > 0.0:
            fading = float(np.exp(-window_s / samples / joint.torque_model_correlation_s))
            at_nodes = covariance_at_nodes(samples, m, fading)
            covariance[k] = joint.torque_model_sigma_nm**2 * at_nodes
    return covariance


def ordered(bodies: Sequence[str]) -> tuple[str, ...]:
    """Return bodies in the order of the state: base, target, then the others as they are."""
    first = [name for name in ("base", "target") if name in bodies]
    return (*first, *(name for name in bodies if name not in first))


def holds(config: Config, model: RobotModel, unknown: tuple[str, ...]) -> dict[str, Hold]:
    """Return how each body but the base hangs on the robot.

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


def _zero_sigmas(joints: Sequence[JointConfig], walks: Walks | None) -> list[float]:
    """Return the sigma of every joint's zero, what had walked before the first knot included."""
    variance = np.array([joint.zero_sigma_rad for joint in joints]) ** 2
    if walks is not None:
        variance[walks.joints] += walks.knots_rad2[:, 0] + LEAST_RAD2  # a state in any case
    return list(np.sqrt(variance))


def _steps(names: Sequence[str], walks: Walks | None) -> tuple[list[str], list[float]]:
    """Return a label and the sigma of every step of every walk."""
    if walks is None:
        return [], []
    sigmas = np.sqrt(walks.steps_rad2)
    labels = [f"{names[j]}.{k + 1}" for j in walks.joints for k in range(sigmas.shape[1])]
    return labels, sigmas.ravel().tolist()


def build_problem(
    config: Config, model: RobotModel, *, exact: bool = False, blocks: Sequence[Block] = ()
) -> Problem:
    """Lay out the state and its prior for one configuration.

    `exact`: known bodies, zeros of the joints and the inertial unit's mounting are as configured.
    `blocks` are those that integrated angles are to walk along; none: see `walks_of`.

    Raises
    ------
    ConfigError if the joints do not match the robot's.
    """
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
    means, covariances, names, liquids, slices = [], [], [], [], []
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
    imu, estimator = config.imu, config.estimator
    thrusters = [thruster.name for thruster in config.thrusters]
    nuisances = (
        ("torque_offset", model.joint_names, [j.torque_offset_sigma_nm for j in joints]),
        ("acc_bias", "xyz", [imu.acc_bias_sigma_m_s2] * 3),
        ("gyro_bias", "xyz", [imu.gyro_bias_sigma_rad_s] * 3),
        ("momentum", "xyz", [estimator.momentum_sigma_nms] * 3),
        ("torque_scale", model.joint_names, [j.torque_scale_sigma_ratio for j in joints]),
        (
            "wrench",
            ("fx", "fy", "fz", "tx", "ty", "tz"),
            [estimator.external_force_sigma_n] * 3 + [estimator.external_torque_sigma_nm] * 3,
        ),
        (
            "target_wrench",
            ("fx", "fy", "fz", "tx", "ty", "tz", "ex", "ey", "ez"),
            [estimator.target_force_sigma_n] * 3
            + [estimator.target_torque_sigma_nm] * 3
            + [estimator.target_force_sigma_n] * 3,
        ),
        ("joint_zero", model.joint_names, _zero_sigmas(joints, walks)),
        ("imu_place", "xyz", [imu.mounting_position_sigma_m] * 3),
        ("imu_angle", "xyz", [imu.mounting_angle_sigma_rad] * 3),
        ("friction_coulomb", model.joint_names, [j.friction_coulomb_sigma_nm for j in joints]),
        ("friction_viscous", model.joint_names, [j.friction_viscous_sigma_nms_rad for j in joints]),
        (
            "wheel_scale",
            [wheel.name for wheel in config.wheels],
            [wheel.inertia_sigma_ratio for wheel in config.wheels],
        ),
        ("wheel_delay", [w.name for w in config.wheels], [w.delay_sigma_s for w in config.wheels]),
        ("thrust_scale", thrusters, [t.force_sigma_ratio for t in config.thrusters]),
        ("thrust_delay", thrusters, [t.delay_sigma_s for t in config.thrusters]),
        ("thrust_rise", thrusters, [t.rise_sigma_s for t in config.thrusters]),
        ("joint_walk", *_steps(model.joint_names, walks)),
    )
    for kind, labels, sigmas in nuisances:
        if not any(sigmas) or (exact and kind in CALIBRATION):
            slices.append(NO_STATES)
            continue
        slices.append(slice(len(names), len(names) + len(sigmas)))
        names += [f"{kind}.{label}" for label in labels]
        means.append(np.zeros(len(sigmas)))
        spread = np.maximum(sigmas, 1e-9)
        shared = SHARED_SCALE if kind in SHARED else 0.0
        covariances.append(np.diag((1.0 - shared) * spread**2) + shared * np.outer(spread, spread))
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
        torque_offset=slices[0],
        acc_bias=slices[1],
        gyro_bias=slices[2],
        momentum=slices[3],
        torque_scale=slices[4],
        wrench=slices[5],
        target_wrench=slices[6],
        joint_zero=slices[7],
        imu_place=slices[8],
        imu_angle=slices[9],
        friction_coulomb=slices[10],
        friction_viscous=slices[11],
        wheel_scale=slices[12],
        wheel_delay=slices[13],
        wheel_axes=np.array([wheel.axis_B for wheel in config.wheels]).reshape(-1, 3).T,
        thrust_scale=slices[14],
        thrust_delay=slices[15],
        thrust_rise=slices[16],
        joint_walk=slices[17],
        walks=walks if present(slices[17]) else None,
        thrusters=Thrusters.of(config),
        friction_speed_rad_s=np.array([j.friction_speed_rad_s for j in joints]),
        target_com_m=np.array(
            config.bodies["target"].com_m if "target" in config.bodies else np.zeros(3)
        ),
        p_BS_m=np.array(imu.mounting.p_BS_m),
        orbit=CircularOrbit.from_config(config.orbit) if config.orbit is not None else None,
        window_s=estimator.window_s,
        nodes=estimator.nodes,
        noise_declared=np.array(
            [
                *(j.torque_noise_nm for j in joints),
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
