"""The estimation problem: which parameters are unknown, their prior, and the state's layout.

State x = [10 parameters per unknown body (base first, then target), ways in which the known bodies
may differ (up to 10 each), torque offsets (n), accelerometer bias (3), gyro bias (3), residual
angular momentum (3), torque scale errors (n), external wrench (6), wrench on the target (9), zeros
of the joints (n), place (3) and angles (3) of the inertial unit, scales (3) and axes (3) of its
gyro, Coulomb and viscous friction of
the joints (n each), relative errors of the wheels' inertias and errors of their delays (k each), of
K thrusters relative errors of the forces, errors of the delays and of the rise times, steps of the
walks of integrated angles, and what `modes` appends]. Where a prior sigma is zero there is no
state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.estimators.model.inertia import (
    PARAMETERS,
    consistent_state,
)
from fsw.estimators.model.modes import Modes
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.model.walks import Walks
from fsw.messages import FloatArray

NO_STATES = slice(0, 0)
MODE_REACH = 3.0  # sigmas of a mode's prior within which it is linearised
IMPLAUSIBLE = 10.0  # sigmas of a value of arm or calibration that its prior cannot be meant for
CONSPICUOUS = 4.0  # the same, to be named
TAIL_RISES = 10.0  # rise times after which a force has settled
THRUST = ("thrust_scale", "thrust_delay", "thrust_rise")
CALIBRATION = (
    *("joint_zero", "joint_walk", "imu_place", "imu_angle", "gyro_scale", "gyro_axes"),
    *("wheel_scale", "wheel_delay"),
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
    gyro_scale: slice  # true rate along each axis of the unit, over what the gyro reads, less 1
    gyro_axes: slice  # angles by which axes xy, xz, yz of the gyro lean to one another [rad]
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
    R_BS: FloatArray  # (3, 3) the unit's axes to base axes, as configured
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
            *(self.gyro_scale, self.gyro_axes, self.wheel_scale, self.wheel_delay),
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

        Modes stay within MODE_REACH sigma of their prior; the base stays heavier than its modes.
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
