"""The estimation problem: which parameters are unknown, their prior, and the state's layout.

State x = [10 parameters per unknown body (base first, then target), errors of the known bodies'
inertial data (up to 10 each), torque offsets (n), accelerometer bias (3), gyro bias (3), residual
angular momentum (3), torque scale errors (n), external wrench (6), wrench on the target (9), zeros
of the joints (n), place (3) and angles (3) of the inertial unit, scales (3) and axes (3) of its
gyro, Coulomb and viscous friction of the joints (n each), relative errors of the wheels' inertias
and errors of their delays (k each), relative errors of the thrusters' forces, errors of their
delays and of their rise times (K each), steps of the random walks of integrated angles, and the
states that `modes` appends]. A group whose prior sigmas are all zero has no states.
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
MODE_REACH = 3.0  # sigmas of a mode's prior within which its states are kept
IMPLAUSIBLE = 10.0  # sigmas from its prior at which a value of arm or calibration contradicts it
CONSPICUOUS = 4.0  # sigmas from its prior at which such a value is named
TAIL_RISES = 10.0  # rise times after which a force counts as settled
THRUST = ("thrust_scale", "thrust_delay", "thrust_rise")
CALIBRATION = (
    *("joint_zero", "joint_walk", "imu_place", "imu_angle", "gyro_scale", "gyro_axes"),
    *("wheel_scale", "wheel_delay"),
    *THRUST,
)
IndexArray = NDArray[np.intp]


def no_states() -> slice:
    """Return the empty slice, for a group that is not part of the state."""
    return slice(0, 0)


def present(states: slice) -> bool:
    """Return whether a group, given by its slice, is part of the state."""
    return bool(states.stop > states.start)


@dataclass(frozen=True, slots=True, eq=False)
class Thrusters:
    """Configured forces, delays and rise times of K thrusters."""

    ways: FloatArray  # (6, K) nominal force [N], moment about the base's origin [N m], in B
    delay_s: FloatArray  # (K,)
    rise_s: FloatArray

    def __len__(self) -> int:
        """Return the number of thrusters."""
        return len(self.delay_s)

    @property
    def tail_s(self) -> FloatArray:
        """Return the time (K,) from a change of the valve to the settled force [s]."""
        tail_s: FloatArray = self.delay_s + TAIL_RISES * self.rise_s
        return tail_s

    @staticmethod
    def of(config: Config) -> Thrusters:
        """Return the thrusters of a configuration."""
        own = config.thrusters
        force = np.array([t.force_n * np.array(t.direction_B) for t in own]).reshape(-1, 3)
        place = np.array([t.p_B_m for t in own]).reshape(-1, 3)
        ways = np.concatenate([force, np.cross(place, force)], axis=1).T
        times = np.array([(t.delay_s, t.rise_s) for t in own]).reshape(-1, 2)
        return Thrusters(ways, times[:, 0], times[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Everything the measurement functions need besides the data.

    `pi_known` (10 (n+1),) holds the known bodies only: an unknown body counts as zero in it. `U`
    (10 (n+1), k) maps the k inertial states (unknown bodies, then errors of known ones) into pi, so
    that pi = pi_known + U x[:k]. Sensor geometry is in base axes.
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
    gyro_scale: slice  # true rate over the gyro's reading along each axis of the unit, less 1
    gyro_axes: slice  # angles by which axes xy, xz, yz of the gyro lean to one another [rad]
    friction_coulomb: slice  # of each joint, as its torque sensor measures it [N m]
    friction_viscous: slice  # [N m s/rad]
    wheel_scale: slice  # relative error of each wheel's axial inertia
    wheel_delay: slice  # true delay less the configured one [s]
    wheel_axes: FloatArray  # (3, k) of the reaction wheels, in B
    thrust_scale: slice  # relative error of each thruster's force
    thrust_delay: slice  # true delay less the configured one [s]
    thrust_rise: slice  # true rise time less the configured one [s]
    thrusters: Thrusters
    friction_speed_rad_s: FloatArray  # (n,) rate at which Coulomb friction is tanh(1) of its size
    target_wrench: slice  # as `wrench`, at the target's centre of mass; then a force in axes E [N]
    target_com_m: FloatArray  # (3,) in E: where `target_wrench` acts on a known target
    p_BS_m: FloatArray  # (3,) place of the accelerometer, as configured
    R_BS: FloatArray  # (3, 3) the unit's axes to base axes, as configured
    orbit: CircularOrbit | None  # None: no gravity gradient
    window_s: float
    nodes: int  # number in a block
    noise_declared: FloatArray  # (n + 2,) 1 sigma of a sample: torques, gyro, accelerometer
    noise_samples: NDArray[np.int64]  # (n + 2,) number of samples in a window, of the same sensors
    torque_model_nm2: FloatArray  # (n, m, m) covariance at nodes of torques outside the model
    wrench_sigma: FloatArray  # (6,) 1 sigma of the unmodelled external wrench, per node
    freedom: FloatArray  # (6, k) motions [v_b, w_b] that are free, orthonormal
    support_m_s2: FloatArray  # (3,) acceleration by which a support keeps the base from falling
    watches_outside: bool  # whether blocks may be marked as having an unknown momentum
    liquid: FloatArray  # (p, p) covariance that liquid in the bodies adds to the published one
    mode_mass: slice = field(
        default_factory=no_states
    )  # relative error of the inertia of each of the base's modes
    mode_frequency: slice = field(
        default_factory=no_states
    )  # logarithm of the factor on the configured frequency
    mode_damping: slice = field(default_factory=no_states)
    mode_start: slice = field(
        default_factory=no_states
    )  # coordinates, then rates, at the start of the data [m or rad, and per s]
    joint_walk: slice = field(default_factory=no_states)  # see `Walks` [rad]
    walks: Walks | None = None  # None: no encoder gives speed only
    modes: Modes | None = None  # None: no modes, or this problem's robot has them as joints

    @property
    def is_free(self) -> bool:
        """Return whether nothing holds the base."""
        return bool(self.freedom.shape[1] == self.freedom.shape[0])

    @property
    def bodies(self) -> slice:
        """Return the states that are parameters of unknown bodies."""
        return slice(0, PARAMETERS * len(self.unknown))

    @property
    def shown(self) -> IndexArray:
        """Return the body parameters that a motion can show: all; without joints all but the mass.

        A body on which no known force acts moves alike whatever its mass, if its centre of mass and
        its inertia about the centre of mass are the same.
        """
        every = np.arange(self.bodies.stop)
        return every if self.model.n else every[every % PARAMETERS > 0]

    @property
    def inertial(self) -> slice | IndexArray:
        """Return the states that are inertial data, of unknown bodies and of known ones.

        Where the robot has the modes as joints, the states of their masses are included.
        """
        own, count = self.U.shape[1], self.mode_mass.stop - self.mode_mass.start
        if count == 0 or self.modes is not None:
            return slice(0, own)
        return np.concatenate([np.arange(own - count), np.arange(len(self.names))[self.mode_mass]])

    @property
    def prior(self) -> Prior:
        """Return the prior of the state."""
        return self.prior_of(self.prior_mean, self.prior_covariance)

    def prior_of(self, mean: FloatArray, covariance: FloatArray) -> Prior:
        """Return a prior of another mean (p,) and covariance (p, p)."""
        return Prior(mean, covariance, tuple(self.body(name) for name in self.unknown))

    @property
    def known(self) -> slice:
        """Return the states that are errors of the known bodies."""
        first = self.bodies.stop
        return slice(first, first + sum(name.startswith("known.") for name in self.names))

    @property
    def published(self) -> IndexArray:
        """Return the states that are published: no known bodies, calibration or start of modes."""
        hidden = (
            self.known,
            *(self.joint_zero, self.joint_walk, self.imu_place, self.imu_angle),
            *(self.gyro_scale, self.gyro_axes, self.wheel_scale, self.wheel_delay),
            *(self.thrust_scale, self.thrust_delay, self.thrust_rise, self.mode_start),
        )
        return np.delete(np.arange(len(self.names)), np.r_[hidden])

    def least_plausible(self, x: FloatArray) -> tuple[str, float]:
        """Return the state of arm or calibration farthest from its prior, and its sigmas."""
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
        """Return a note on a state of arm or calibration beyond CONSPICUOUS sigma, or ""."""
        name, sigmas = self.least_plausible(x)
        return f"; {name} is {sigmas:.0f} sigma off" if sigmas > CONSPICUOUS else ""

    def place_m(self, x: FloatArray) -> FloatArray:
        """Return the accelerometer's place in B (3,) for the state x [m]."""
        return self.p_BS_m + x[self.imu_place] if present(self.imu_place) else self.p_BS_m

    def body(self, name: str) -> slice:
        """Return the slice of the ten states of an unknown body."""
        start = PARAMETERS * self.unknown.index(name)
        return slice(start, start + PARAMETERS)

    def consistent(self, x: FloatArray, covariance: Callable[[], FloatArray]) -> FloatArray:
        """Return x (p,) with each body moved to the nearest consistent one and modes limited.

        Modes stay within MODE_REACH sigma of their prior; the base stays consistent without its
        modes. `covariance` returns that of the state (p, p).
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
