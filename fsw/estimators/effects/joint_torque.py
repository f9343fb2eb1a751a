"""Torques that a joint's sensor measures besides that of the rigid bodies.

    measured = (tau + sum_k x_k phi_k(q, qd, qdd, tau)) (1 + scale) + offset        x_k: states

Each state x_k belongs to one joint, and phi_k depends on the motion of that joint alone, or on the
torque tau of the rigid bodies that the joint transmits. A `TorqueEffect` declares a group of such
states and their phi.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.model.state_group import Setting, StateGroup
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class JointMotion:
    """Angles, rates and accelerations at the nodes of B blocks, each (B, m, n).

    `load_nm` is the torque of the rigid bodies; None where no effect depends on it.
    """

    q_rad: FloatArray
    qd_rad_s: FloatArray
    qdd_rad_s2: FloatArray
    load_nm: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Basis:
    """phi of k states at the nodes (B, m, k), and its derivatives by the same node's values."""

    value: FloatArray
    by_angle: FloatArray | float = 0.0
    by_rate: FloatArray | float = 0.0
    by_acceleration: FloatArray | float = 0.0
    by_load: FloatArray | float = 0.0


Shape = Callable[[JointMotion], Basis]


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueEffect:
    """One effect: its states, the joint of each, and phi for a configuration."""

    group: StateGroup
    shape: Callable[[Setting], Shape]
    is_of_load: bool = False  # whether phi is proportional to the load
    joints: Callable[[Setting], Sequence[int]] = lambda setting: range(len(setting.joints))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueTerm:
    """One effect of one problem."""

    states: slice
    joints: NDArray[np.intp]  # (k,)
    shape: Shape
    is_of_load: bool


@dataclass(frozen=True, slots=True, eq=False)
class Added:
    """Sum of all effects at the nodes (N, n) [N m]; derivatives by the joint's motion and load."""

    torque_nm: FloatArray
    by_angle: FloatArray
    by_rate: FloatArray
    by_acceleration: FloatArray
    by_load: FloatArray


def terms_of(
    effects: Sequence[TorqueEffect], setting: Setting, places: dict[str, slice]
) -> tuple[TorqueTerm, ...]:
    """Return the terms of the effects whose groups are part of the state."""
    return tuple(
        TorqueTerm(
            states=places[effect.group.name],
            joints=np.array(effect.joints(setting), np.intp),
            shape=effect.shape(setting),
            is_of_load=effect.is_of_load,
        )
        for effect in effects
        if effect.group.name in places
    )


def added(terms: Sequence[TorqueTerm], motion: JointMotion, x: FloatArray) -> Added:
    """Return the sum of the terms at a state x (p,).

    The derivatives serve for the noise of the motion; the neighbouring nodes' share is left out.
    """
    blocks, nodes, n = motion.q_rad.shape
    sums = np.zeros((5, blocks * nodes, n))
    for term in terms:
        basis, own = term.shape(motion), x[term.states]
        by_motion = (basis.by_angle, basis.by_rate, basis.by_acceleration)
        parts = (basis.value, *by_motion, basis.by_load)
        for total, part in zip(sums, parts, strict=True):
            if np.any(part):
                np.add.at(total.T, term.joints, (own * part).reshape(len(total), -1).T)
    return Added(*sums)


def fill_columns(J: FloatArray, terms: Sequence[TorqueTerm], motion: JointMotion) -> None:
    """Add the derivatives by the terms' states to torque rows J (N, n, p)."""
    for term in terms:
        value = term.shape(motion).value.reshape(len(J), -1)
        J[:, term.joints, np.arange(J.shape[2])[term.states]] += value
