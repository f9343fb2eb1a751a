"""What moves the base besides the arm in a run, and what the flight software cannot know of it.

Wheels and thrusters exchange momentum with the base. Each has an error of its declaration (the
inertia of a wheel, the force of a jet), whose share of wrench and momentum is known but for one
number. The delay of a jet's force, which moves a known impulse by milliseconds, counts as known.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hil.judge.floating import FloatingRobot
from hil.world.history import TruthHistory, TruthState
from hil.world.inertia import FloatArray
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem

FINE_S = 0.002  # step of the sum of a jet's impulse, well below its rise time


class Applied(NamedTuple):
    """What acts on the base at one instant, force or linear part first, in base axes."""

    wrench: FloatArray = np.zeros(6)  # [N, N m]
    momentum: FloatArray = np.zeros(6)  # of base and arm [N s, N m s]


class Doubt(NamedTuple):
    """One unknown error of a wheel or jet, and what it adds at k instants, in base axes."""

    sigma: float  # of the relative error
    wrench: FloatArray  # (k, 6) [N, N m] for a relative error of 1
    momentum: FloatArray  # (k, 6) [N s, N m s] likewise


NOTHING = Applied()


def applied_in(robot: FloatingRobot, x: FloatArray, state: TruthState) -> list[Applied]:
    """Return what must have acted on the base in each of k true states; nothing on a stand."""
    if robot.stand is not None:
        return [NOTHING] * len(state.t_s)
    pi, still = robot.stacked(x), np.zeros(6 + robot.n)
    v_B = np.einsum("kji,kj->ki", state.R_NB, state.v_NB_N)
    rates = np.hstack((v_B, state.w_NB_B, state.qd))
    turning = np.hstack((np.zeros_like(v_B), rates[:, 3:]))  # nothing depends on v_B
    change = np.hstack((state.a_NB_B - state.g_NB_B, state.wd_NB_B, state.qdd))
    return [
        Applied((robot.regressor(q, nu, a) @ pi)[:6], (robot.regressor(q, still, rate) @ pi)[:6])
        for q, nu, a, rate in zip(state.q, turning, change, rates, strict=True)
    ]


def of_wheels(wheels: WheelSystem, history: TruthHistory, state: TruthState) -> Iterator[Doubt]:
    """Yield the doubt of each wheel's inertia."""
    if history.wheel_rad_s is None or history.wheel_rad_s2 is None:
        return
    for k, (axis, inertia) in enumerate(zip(wheels.axes.T, wheels.inertias_kg_m2, strict=True)):
        held = np.zeros((len(state.t_s), 6))
        held[:, 3:] = inertia * axis
        speed = np.interp(state.t_s, history.t_s, history.wheel_rad_s[:, k])[:, None]
        change = np.interp(state.t_s, history.t_s, history.wheel_rad_s2[:, k])[:, None]
        turned = np.zeros_like(held)
        turned[:, 3:] = np.cross(state.w_NB_B, speed * held[:, 3:])
        yield Doubt(wheels.inertia_sigma_ratio, -change * held - turned, -speed * held)


def of_thrusters(
    thrusters: ThrusterSystem, history: TruthHistory, state: TruthState
) -> Iterator[Doubt]:
    """Yield the doubt of the force of all jets together, then that of each jet."""
    sigma = thrusters.force_sigma_ratio * np.sqrt(0.5)
    times = np.arange(history.start_s, history.end_s, FINE_S)
    fine = history.at(times)
    shares = np.array([thrusters.shares(t_s) for t_s in times])  # (k, K)
    each = [
        _impulse(np.outer(share, way), fine, state)
        for share, way in zip(shares.T, thrusters.ways.T, strict=True)
    ]
    wrenches, momenta = zip(*each, strict=True)
    yield Doubt(sigma, np.sum(wrenches, axis=0), np.sum(momenta, axis=0))
    for wrench, momentum in each:
        yield Doubt(sigma, wrench, momentum)


def _impulse(
    wrench_B: FloatArray, fine: TruthState, state: TruthState
) -> tuple[FloatArray, FloatArray]:
    """Return a wrench (k, 6) on the base, and its impulse about the base origin, at a state."""
    force_N, moment_N = (
        np.einsum("kij,kj->ki", fine.R_NB, part) for part in np.split(wrench_B, 2, axis=1)
    )
    change_N = np.hstack((force_N, moment_N + np.cross(fine.p_NB_N, force_N)))
    total_N = (np.cumsum(change_N, axis=0) - 0.5 * change_N) * FINE_S  # the trapezoidal rule
    linear_N, angular_N = np.split(_at(state.t_s, fine.t_s, total_N), 2, axis=1)
    angular_N = angular_N - np.cross(state.p_NB_N, linear_N)
    linear_B, angular_B = (
        np.einsum("kji,kj->ki", state.R_NB, part) for part in (linear_N, angular_N)
    )
    return _at(state.t_s, fine.t_s, wrench_B), np.hstack((linear_B, angular_B))


def _at(t_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(t_s, known_s, column) for column in values.T], axis=1)


def doubts_of(
    wheels: WheelSystem | None,
    thrusters: ThrusterSystem | None,
    history: TruthHistory,
    state: TruthState,
) -> list[Doubt]:
    """Return what the flight software cannot know of wheels and thrusters at k true states."""
    found = [] if wheels is None else list(of_wheels(wheels, history, state))
    return found + ([] if thrusters is None else list(of_thrusters(thrusters, history, state)))
