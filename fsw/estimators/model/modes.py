"""Modes of the base as joints of the robot that springs and dampers drive, and their parameters.

A panel turns about its hinge; liquid slides along one to three axes. Both hang on the base. The
base's own inertial data include the modes at rest. In the released robot every mode is a body of
its own, and the base has its data minus those of the modes. The states of a mode are s (relative
error of its mass and modal inertia), f and d (logarithms of the factors on frequency and damping
ratio). With M the mass of liquid or a panel's inertia about its hinge, w and zeta as configured:

    stiffness  K = M (1 + s) w^2 e^(2 f)        damping  C = 2 zeta e^d w e^f M (1 + s)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config, ModeConfig
from fsw.estimators.effects.on_base import Costly, OnBase, is_free
from fsw.estimators.model.inertia import (
    PARAMETERS,
    about_com,
    frame_change,
    is_consistent,
    to_parameters,
)
from fsw.estimators.model.robot import Appended
from fsw.estimators.model.state_group import Setting, Spread, StateGroup
from fsw.messages import FloatArray

if TYPE_CHECKING:
    from fsw.estimators.model.problem import Problem

NODES_PER_PERIOD = 4.0  # with fewer, the window's polynomial misses a tenth of a swing or more
EXACT = 1e-9  # least sigma of a mode's state, for one that is configured as exact


def _rate_rad_s(mode: ModeConfig) -> float:
    return 2.0 * np.pi * mode.frequency_hz


def _each(key: str) -> Callable[[Setting], Spread]:
    """Return the prior of one state for each mode; the state exists even if it is exact."""

    def prior(setting: Setting) -> Spread:
        modes = setting.config.modes
        return [mode.name for mode in modes], [max(getattr(mode, key), EXACT) for mode in modes]

    return prior


def _starts(setting: Setting) -> Spread:
    """Return label and sigma of every coordinate, then of every rate."""
    modes = setting.config.modes
    labels = [f"{own.name}.{k + 1}" for own in modes for k in range(len(own.axes_B))]
    far = np.array([own.amplitude for own in modes for _ in own.axes_B])
    rate_rad_s = np.array([_rate_rad_s(own) for own in modes for _ in own.axes_B])
    return [*labels, *(f"{label}.rate" for label in labels)], [*far, *(rate_rad_s * far)]


def _amplitudes(config: Config) -> str:
    """Return the largest 1 sigma start amplitudes of liquid [m] and panels [rad] as words."""
    found = []
    for kind, words, unit in (("slosh", "liquid", "m"), ("panel", "panels", "rad")):
        own = [mode.amplitude for mode in config.modes if mode.kind == kind]
        found += [f"{words} by {max(own):.3g} {unit}"] if own else []
    return ", ".join(found)


CAUSE = "modes of the base"


def _error(of: str) -> StateGroup:
    """Return the states of the errors of one quantity, a state for each mode."""
    return StateGroup(
        name=f"mode_{of}",
        effect=f"{of} of modes",
        unit="",
        key=f"modes[].{of}_sigma_ratio",
        cause=CAUSE,
        prior=_each(f"{of}_sigma_ratio"),
        is_judged=True,
    )


MASS = _error("mass")  # relative, of the inertia
FREQUENCY = _error("frequency")  # logarithm of the factor on the configured value
DAMPING = _error("damping")  # likewise, of the damping ratio
START = StateGroup(  # coordinates, then rates, at the start of the data [m or rad, and per s]
    name="mode_start",
    effect="modes that swing already when the motion begins",
    unit="",
    key="modes[].amplitude_*",
    cause=CAUSE,
    prior=_starts,
    is_hidden=True,
    amount=_amplitudes,
)
GROUPS = (MASS, FREQUENCY, DAMPING, START)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modes:
    """The released robot and the springs of its c modal coordinates.

    Attributes
    ----------
    released : the problem whose robot has the modes as joints after those of the arm
    of : (c,) index of the mode of each coordinate
    inertia : (c,) modal inertia of each coordinate, as configured [kg or kg m^2]
    rate_rad_s, damping_ratio : (c,) of each coordinate while the base is held, as configured
    amplitude : (c,) 1 sigma of the distance from rest [m or rad]
    """

    released: Problem
    of: NDArray[np.intp]
    inertia: FloatArray
    rate_rad_s: FloatArray
    damping_ratio: FloatArray
    amplitude: FloatArray

    def springs(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return stiffness and damping (2, c) and their derivatives (2, c, p) by x (p,)."""
        rows = np.arange(len(self.of))
        mass, frequency, damping = (self.released.at(own.name) for own in GROUPS[:3])
        s, f, d = (x[states][self.of] for states in (mass, frequency, damping))
        rate, own = self.rate_rad_s * np.exp(f), self.inertia * (1.0 + s)
        K, C = own * rate**2, 2.0 * self.damping_ratio * np.exp(d) * rate * own
        J = np.zeros((2, len(rows), len(x)))
        J[0, rows, mass.start + self.of] = self.inertia * rate**2
        J[1, rows, mass.start + self.of] = C / own * self.inertia
        J[0, rows, frequency.start + self.of] = 2.0 * K
        J[1, rows, frequency.start + self.of] = C
        J[1, rows, damping.start + self.of] = C
        return np.array([K, C]), J


def own_parameters(mode: ModeConfig) -> FloatArray:
    """Return the ten parameters of a mode's body about its point p_B_m, in axes of B."""
    inertia = np.zeros(6) if mode.inertia_kg_m2 is None else np.array(mode.inertia_kg_m2)
    return to_parameters(mode.mass_kg, np.array(mode.com_m), inertia)


def in_base(mode: ModeConfig) -> FloatArray:
    """Return the ten parameters of a mode's body at rest about the base's origin, in axes of B."""
    seen: FloatArray = frame_change(np.eye(3), np.array(mode.p_B_m)) @ own_parameters(mode)
    return seen


def modal_inertia(mode: ModeConfig) -> float:
    """Return the mass of liquid [kg], or a panel's inertia about its hinge [kg m^2]."""
    if mode.kind == "slosh":
        return mode.mass_kg
    xx, xy, yy, xz, yz, zz = own_parameters(mode)[4:]
    axis = np.array(mode.axes_B[0])
    return float(axis @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axis)


def with_modes(problem: Problem, modes: Sequence[ModeConfig]) -> Problem:
    """Return the problem with its `modes` set; their states are in it already."""
    each = [mode for mode in modes for _ in mode.axes_B]
    return replace(
        problem,
        modes=Modes(
            released=_released(problem, modes),
            of=np.repeat(np.arange(len(modes)), [len(mode.axes_B) for mode in modes]),
            inertia=np.array([modal_inertia(mode) for mode in each]),
            rate_rad_s=np.array([_rate_rad_s(mode) for mode in each]),
            damping_ratio=np.array([mode.damping_ratio for mode in each]),
            amplitude=np.array([mode.amplitude for mode in each]),
        ),
    )


def _released(locked: Problem, modes: Sequence[ModeConfig]) -> Problem:
    """Return the problem whose robot has the modes as joints and whose base excludes them."""
    joints: list[Appended] = []
    pi, columns = [locked.pi_known], []
    for mode in modes:
        for k, axis in enumerate(mode.axes_B):
            place = np.zeros(3) if k else np.array(mode.p_B_m)
            joints.append(Appended(mode.kind == "panel", k > 0, np.array(axis), place))
            pi.append(np.zeros(PARAMETERS))
        pi[-1] = own_parameters(mode)
        column = np.zeros(len(locked.pi_known) + PARAMETERS * sum(len(m.axes_B) for m in modes))
        stop = len(locked.pi_known) + PARAMETERS * len(joints)
        column[:PARAMETERS], column[stop - PARAMETERS : stop] = -in_base(mode), pi[-1]
        columns.append(column)
    whole = np.concatenate(pi)
    whole[:PARAMETERS] += np.sum([column[:PARAMETERS] for column in columns], axis=0)
    U = np.zeros((len(whole), locked.U.shape[1] + len(modes)))
    U[: len(locked.pi_known), : locked.U.shape[1]] = locked.U
    U[:, locked.U.shape[1] :] = np.array(columns).T
    return replace(locked, model=locked.model.with_joints(joints), pi_known=whole, U=U)


def _words(config: Config) -> list[str]:
    """Return a line for each mode with its declared values and the effect of leaving it out."""
    lines = []
    for mode in config.modes:
        inertia, rate_rad_s = modal_inertia(mode), _rate_rad_s(mode)
        is_panel = mode.kind == "panel"
        size = f"{mode.mass_kg:.4g} kg" + f", {inertia:.4g} kg m^2 about its hinge" * is_panel
        far, pull = ("rad", "N m") if is_panel else ("m", "N")
        lines.append(
            f"{mode.name}: {mode.kind}, {size} +- {mode.mass_sigma_ratio:.0%}, "
            f"{mode.frequency_hz:.4g} Hz +- {mode.frequency_sigma_ratio:.0%}, damping ratio "
            f"{mode.damping_ratio:.3g} +- {mode.damping_sigma_ratio:.0%}; left out, it would pull "
            f"with {inertia * rate_rad_s**2 * mode.amplitude:.2g} {pull} at {mode.amplitude:.3g} "
            f"{far} unexplained, and faster motions would miss its mass in base"
        )
    return [*lines, "at rest every mode belongs to base; stops and walls are not modelled"]


def _fault(config: Config, base: FloatArray) -> Iterator[str]:
    """Yield a line for the first mode without which the base (10,) is not a possible body."""
    if not is_consistent(base):
        return  # a fault of the URDF, reported by another check
    rest = base
    for i, mode in enumerate(config.modes):
        rest = rest - in_base(mode)
        if is_consistent(rest):
            continue
        at = f"modes.{i}.mass_kg: {mode.mass_kg:g} ({mode.name}); at rest it belongs to base, "
        if rest[0] <= 0.0:
            yield f"{at}of {base[0]:g} kg; must be below {rest[0] + mode.mass_kg:g}"
            return
        yield (
            f"{at}which without it, at p_B_m {list(mode.p_B_m)}, would have the principal moments "
            f"{np.linalg.eigvalsh(about_com(rest)).round(3).tolist()} kg m^2; must be positive, "
            "each below the sum of the other two"
        )
        return


def _warnings(config: Config) -> list[str]:
    """Return a line for each mode that swings too fast for the nodes of a window."""
    estimator = config.estimator
    most_hz = estimator.nodes / (NODES_PER_PERIOD * estimator.window_s)
    return [
        f"modes.{i}.frequency_hz: {mode.frequency_hz:g} ({mode.name}) is above {most_hz:.3g}, the "
        f"most that estimator.nodes {estimator.nodes} in estimator.window_s {estimator.window_s:g} "
        f"follow ({NODES_PER_PERIOD:g} nodes a period); use more nodes or a shorter window, or "
        "leave the mode out"
        for i, mode in enumerate(config.modes)
        if mode.frequency_hz > most_hz
    ]


def _left_out(config: Config, _fired_s: float) -> list[Costly]:
    """Return each mode, while the others are modelled."""
    modes = config.modes
    words = "mode {0.name} ({0.kind}) as the motion drives it, {0.mass_kg:.3g} kg"
    return [((*modes[:k], *modes[k + 1 :]), words.format(own)) for k, own in enumerate(modes)]


def _is_possible(config: Config) -> bool:
    return is_free(config) and not any(body.liquid for body in config.bodies.values())


ON_BASE = OnBase(
    section="modes",
    absent="panels that bend and liquid that moves: MODEL_MISMATCH at best",
    is_possible=_is_possible,
    words=_words,
    faults=_fault,
    warnings=_warnings,
    left_out=_left_out,
)
