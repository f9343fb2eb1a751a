"""The estimation problem: which parameters are unknown, their prior, and the state's layout.

State x = [10 parameters per unknown body (base first, then target), errors of the known bodies'
inertial data (up to 10 each), then the groups of `state_groups` in their order]. A group whose
prior sigmas are all zero has no states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fsw.config.joints import linear
from fsw.estimators.effects.carried import Carrier
from fsw.estimators.effects.delay import Delays
from fsw.estimators.effects.joint_torque import TorqueTerm
from fsw.estimators.effects.switched import Switched
from fsw.estimators.model.inertia import (
    PARAMETERS,
    consistent_state,
)
from fsw.estimators.model.modes import Modes
from fsw.estimators.model.orbit import CircularOrbit
from fsw.estimators.model.prior import Prior
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.model.state_group import StateGroup
from fsw.estimators.model.state_groups import BY_NAME, group_of, in_words
from fsw.estimators.model.walks import Walks
from fsw.messages import FloatArray

LINEAR_UNITS = {"rad": "m", "N m": "N"}  # of prismatic joints
NO_STATES = slice(0, 0)
MODE_REACH = 3.0  # sigmas of a mode's prior within which its states are kept
IMPLAUSIBLE = 10.0  # sigmas from its prior at which a value of arm or calibration contradicts it
CONSPICUOUS = 4.0  # sigmas from its prior at which such a value is named
IndexArray = NDArray[np.intp]


def _hidden(group: StateGroup) -> bool:
    return not group.is_published


def _judged(group: StateGroup) -> bool:
    return group.is_judged or not group.is_published


@lru_cache(maxsize=16)
def _where(names: tuple[str, ...], first: int, holds: Callable[[StateGroup], bool]) -> IndexArray:
    groups = [group_of(name) for name in names]
    return np.array([first + k for k, own in enumerate(groups) if own and holds(own)], np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """Constants of the sensors that might creep; see `creep`."""

    problem: Problem  # in which none of them is exact
    names: tuple[str, ...]  # of states in it; a group's name is all its states at once
    columns: FloatArray  # (p, q) of its states, for each name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Everything the measurement functions need besides the data.

    `pi_known` (10 K,) holds the known bodies only: an unknown body counts as zero in it. `U`
    (10 K, k) maps the k inertial states (unknown bodies, then errors of known ones) into pi, so
    that pi = pi_known + U x[:k]. Sensor geometry is in base axes.
    """

    model: RobotModel
    unknown: tuple[str, ...]
    pi_known: FloatArray
    U: FloatArray
    names: tuple[str, ...]
    prior_mean: FloatArray
    prior_covariance: FloatArray
    places: Mapping[str, slice]  # of each group of states that is present
    carrier: Carrier  # of momentum in the base
    switched: Switched  # forces on the base
    delays: Delays  # of channels and stamps
    torque_terms: tuple[TorqueTerm, ...]  # torques besides that of the rigid bodies
    of_current: NDArray[np.bool_]  # (n,) whether a joint's torque is that of its motor's current
    target_com_m: FloatArray  # (3,) in E: where the target's wrench acts on a known target
    p_BS_m: FloatArray  # (3,) place of the accelerometer, as configured
    R_BS: FloatArray  # (3, 3) the unit's axes to base axes, as configured
    orbit: CircularOrbit | None  # None: no gravity gradient
    angles_are_noisy: bool  # whether their errors count besides those of rates
    window_s: float
    nodes: int  # number in a block
    noise_declared: FloatArray  # (t + 2,) 1 sigma of a sample: torques, gyro, accelerometer
    noise_samples: NDArray[np.int64]  # (t + 2,) number of samples in a window, of the same sensors
    torque_model_nm2: FloatArray  # (t, m, m) covariance at nodes of torques outside the model
    wrench_sigma: FloatArray  # (6,) 1 sigma of the unmodelled external wrench, per node
    freedom: FloatArray  # (6, k) motions [v_b, w_b] that are free, orthonormal
    support_m_s2: FloatArray  # (3,) acceleration by which a support keeps the base from falling
    watches_outside: bool  # whether blocks may be marked as having an unknown momentum
    liquid: FloatArray  # (p, p) covariance that liquid in the bodies adds to the published one
    walks: Walks | None = None  # None: no encoder gives speed only
    modes: Modes | None = None  # None: no modes, or this problem's robot has them as joints
    watched: Watched | None = None  # constants of sensors; None: none is exact, nothing is watched

    def at(self, group: str) -> slice:
        """Return the states of a group; empty if it is not part of the state.

        Raises
        ------
        KeyError if `state_groups` has no such group.
        """
        return self.places.get(BY_NAME[group].name, NO_STATES)

    def has(self, group: str) -> bool:
        """Return whether a group is part of the state.

        Raises
        ------
        KeyError if `state_groups` has no such group.
        """
        states = self.at(group)
        return bool(states.stop > states.start)

    def sensed(self, joints: str, axes: str) -> list[tuple[slice, slice]]:
        """Return states and torques of two groups: of joints, and of axes of wrench sensors."""
        n = self.model.n
        torques = slice(0, n), slice(n, len(self.model.torque_units))
        pairs = zip((joints, axes), torques, strict=True)
        return [(self.at(group), rows) for group, rows in pairs if self.has(group)]

    def placed(self, **places: slice) -> Problem:
        """Return the problem with these groups at other places of the state."""
        return replace(self, places={**self.places, **places})

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
        masses = self.at("mode_mass")
        own, count = self.U.shape[1], masses.stop - masses.start
        if count == 0 or self.modes is not None:
            return slice(0, own)
        return np.concatenate([np.arange(own - count), np.arange(len(self.names))[masses]])

    @property
    def prior(self) -> Prior:
        """Return the prior of the state."""
        return self.prior_of(self.prior_mean, self.prior_covariance)

    def prior_of(self, mean: FloatArray, covariance: FloatArray) -> Prior:
        """Return a prior of another mean (p,) and covariance (p, p)."""
        bodies = tuple(self.body(name) for name in self.unknown)
        return Prior(mean, covariance, bodies, *self._read)

    @property
    def _read(self) -> tuple[IndexArray, FloatArray]:
        """Return the states whose prior is in the reading's scale (k,), and their gains (k, p).

        Those of a held arm that measures motor current, whose gains are in doubt. The torque of a
        link's error is read by several joints: it has the mean of their scales.
        """
        scales, of_current = self.at("torque_scale"), self.of_current
        count = scales.stop - scales.start
        if self.freedom.shape[1] or count == 0 or not of_current.any():
            return np.empty(0, np.intp), np.empty((0, len(self.names)))
        places = [k for k, name in enumerate(self.names) if name.startswith("known.link.")]
        weights = [of_current / of_current.sum()] * len(places)
        for term in self.torque_terms:
            if not term.is_of_load:
                places += range(term.states.start, term.states.stop)
                weights += list(np.diag(of_current.astype(float))[term.joints])
        gains = np.zeros((len(places), len(self.names)))
        gains[:, scales] = np.reshape(weights, (-1, count))
        return np.array(places, np.intp), gains

    @property
    def known(self) -> slice:
        """Return the states that are errors of the known bodies."""
        first = self.bodies.stop
        return slice(first, first + sum(name.startswith("known.") for name in self.names))

    def where(self, holds: Callable[[StateGroup], bool]) -> IndexArray:
        """Return the states of the groups for which a condition holds."""
        return _where(self.names[self.bodies.stop :], self.bodies.stop, holds)

    @property
    def published(self) -> IndexArray:
        """Return the states that are published: no known bodies, calibration or start of modes."""
        return np.delete(np.arange(len(self.names)), self.where(_hidden))

    def least_plausible(self, x: FloatArray) -> tuple[str, float]:
        """Return the state of arm or calibration farthest from its prior, and its sigmas."""
        doubts = self.where(_judged)
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
        if sigmas <= CONSPICUOUS:
            return ""
        (kind, _, label), k = name.partition("."), self.names.index(name)
        unit, key = BY_NAME[kind].unit, BY_NAME[kind].key
        if self.model.torque_units.get(label) == "N":  # of a prismatic joint
            unit, key = LINEAR_UNITS.get(unit, unit), linear(key)
        off = x[k] - self.prior_mean[k]
        size = f"{off:+.3g} {unit}".rstrip()
        cure = f"correct it, or state its doubt by {key}"
        if kind == "torque_scale" and off < -1.0:
            cure = "the torque counts the other way: set torque_gain to -1 times its value"
        return (
            f"; {in_words(name)}: estimated {sigmas:.0f} sigma ({size}) from what is configured; "
            f"{cure}"
        )

    def place_m(self, x: FloatArray) -> FloatArray:
        """Return the accelerometer's place in B (3,) for the state x [m]."""
        return self.p_BS_m + x[self.at("imu_place")] if self.has("imu_place") else self.p_BS_m

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
            k = np.r_[self.at("mode_mass"), self.at("mode_frequency"), self.at("mode_damping")]
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
        """Return the parameters of all bodies (10 K,) for the state x."""
        return self.pi_known + self.U @ x[self.inertial]
