"""The effects whose size a configuration or its URDF declares, and the error of leaving each out.

The size of an effect that has states is their prior sigma. Otherwise: what can turn in the base
holds it still within its limits; valves open as the motion says; modes swing as the motion drives
them; if no orbit is configured, a low one is assumed; group delays are not subtracted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fsw.config import Config, OrbitConfig, Section
from fsw.config.constants import EARTH_GRAVITY_PARAMETER_M3_S2
from fsw.estimators.effects.registered import ON_BASE
from fsw.estimators.model.building import build_problem, joint_order
from fsw.estimators.model.inertia import PARAMETERS
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.model.state_groups import GROUPS
from fsw.messages import FloatArray, IntArray
from planner import firings
from planner.left_out import (
    Information,
    Shift,
    blocks_along,
    channels,
    half_ns,
    held,
    late,
    measured,
)
from planner.nominal import nominal_motion
from planner.spline import Trajectory

LOW_ORBIT_RAD_S = 1.16e-3  # mean motion at 300 km
FIRING_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """The errors of the masses if one effect is left out of the model."""

    effect: str  # name and size
    key: str
    is_modelled: bool
    mass_kg: tuple[float, ...]  # mass error of each unknown body
    sigmas: tuple[float, ...]  # the same errors in units of the predicted sigma

    def text(self, bodies: Sequence[str]) -> str:
        """Return one line: effect, whether it is modelled, and its cost."""
        parts = (
            f"{kg:.2g} kg of {body} ({sigmas:.2g} sigma)"
            for body, kg, sigmas in zip(bodies, self.mass_kg, self.sigmas, strict=True)
        )
        state = "modelled; left out, it would cost" if self.is_modelled else "ignored; may cost"
        return f"{self.effect} ({self.key}): {state} {', '.join(parts)}"


def told(config: Config, problem: Problem, motion: Trajectory | None) -> list[str]:
    """Return the costs as lines, by default of the nominal motion; no lines without joints."""
    if not problem.model.n:  # without joints, no mass can be identified
        return []
    trajectory = motion or nominal_motion(config, problem.model)
    words = "this motion" if motion else "a motion in which every joint swings"
    known = costs(config, problem, trajectory)
    found = [cost.text(problem.unknown) for cost in known]
    if not any(max(cost.mass_kg) > 0.0 for cost in known):
        found = [f"none: {words} does not determine the mass of {' or '.join(problem.unknown)}"]
    return [
        f"over {trajectory.duration_s:g} s of {words}, linearised: error of a mass from an effect "
        "of its declared size (in sigmas predicted without it):",
        *found,
        f"no size declared, so no cost: {', '.join(undeclared(config, problem)) or 'nothing'}",
    ]


def undeclared(config: Config, problem: Problem) -> list[str]:
    """Return the effects without a declared size, each with the key that would declare the size."""
    full = build_problem(with_sizes(config, problem), problem.model)
    kinds = {name.partition(".")[0] for name in full.names}
    found = [
        f"{group.effect} ({group.key})"
        for group in GROUPS
        if group.name not in kinds and group.applies_to(config)
    ]
    if config.base.motion == "free":
        sections = [kind.section for kind in ON_BASE]
        found += [f"{name} ({name})" for name in sections if not getattr(config, name)]
        if config.estimator.outside_wrench == "ignore":
            found.append("contact of the target (estimator.outside_wrench)")
    return found


def costs(config: Config, problem: Problem, trajectory: Trajectory) -> list[Cost]:
    """Return the cost of every effect of declared size along a motion, unmodelled effects first."""
    flight = _Flight(config, problem, trajectory)
    if not flight.blocks:
        return []
    found = [
        *_of_states(flight),
        *_of_parts(flight),
        *_of_unknown_firing(flight),
        *_of_orbit(flight),
        *_of_delays(flight),
    ]
    return sorted(found, key=lambda cost: (cost.is_modelled, -max(cost.sigmas)))


class _Flight:
    """The blocks of a motion under a configuration, and the errors of leaving effects out."""

    def __init__(self, config: Config, problem: Problem, trajectory: Trajectory) -> None:
        self.config, self.problem, self.trajectory = config, problem, trajectory
        blocks = blocks_along(config, problem, trajectory)
        self.blocks = held(blocks, problem) if len(problem.carrier.most_nm) else blocks

    @cached_property
    def information(self) -> Information:
        """Return the estimator's rows of the configured problem."""
        return Information(self.problem, _method(self.config), self.blocks)

    def unknown(self, values: Sequence[FloatArray]) -> Shift:
        """Return the error from measured channels (m, t + 6) that the model does not explain."""
        return self.information.shift(measured(self.blocks, values))

    def without(
        self, section: str, values: Sequence[FloatArray], rest: tuple[Section, ...] = ()
    ) -> tuple[Problem, Shift]:
        """Return the problem with only `rest` of a section, and the error if `values` have all."""
        config = self.config.model_copy(update={section: rest})
        problem = problem_of(config, self.problem.model)
        blocks = blocks_along(config, problem, self.trajectory)
        own = Information(problem, _method(config), blocks)
        return problem, own.shift(measured(blocks, values))


def problem_of(config: Config, model: RobotModel) -> Problem:
    """Return the estimation problem of a configuration."""
    return build_problem(config, model, exact=config.estimator.is_regression)


def _method(config: Config) -> str:
    own = config.estimator.method
    return "fused" if own == "mrnea" else own  # its rows contain every effect


def _of_states(flight: _Flight) -> Iterator[Cost]:
    config, problem = flight.config, flight.problem
    sized = with_sizes(config, problem)
    full = build_problem(sized, problem.model)
    own = Information(full, _method(config), flight.blocks)
    kinds = np.array([name.partition(".")[0] for name in full.names])
    used = np.isin(full.names, problem.names)
    sizes = np.sqrt(np.diag(full.prior_covariance))
    for group in GROUPS:
        kind = group.name
        for is_modelled in (False, True):
            states: IntArray = np.flatnonzero((kinds == kind) & (used == is_modelled))
            if not len(states):
                continue
            apart = np.flatnonzero(~used & (kinds != kind))
            amount = f"{sizes[states].max():.3g} {group.unit}".rstrip()
            amount = group.amount(config) if group.amount else amount
            told = f"{group.effect}, {amount}"
            yield _cost(full, own.without(states, apart), told, group.key, is_modelled=is_modelled)


def with_sizes(config: Config, problem: Problem) -> Config:
    """Return a configuration completed by effect sizes that are declared at other keys.

    These are the friction in the URDF and the momentum that parts of the base can hold.
    """
    model = problem.model
    order = joint_order(config, model)
    joints = list(config.joints)
    for place, k in enumerate(order):
        joint = joints[k]
        if joint.torque == "none":
            continue
        urdf = {
            "friction_coulomb_sigma_nm": float(model.plain.model.friction[6 + place]),
            "friction_viscous_sigma_nms_rad": float(model.plain.model.damping[6 + place]),
        }
        new = {key: size for key, size in urdf.items() if size and not getattr(joint, key)}
        joints[k] = joint.model_copy(update=new)
    estimator = config.estimator
    held = float(problem.carrier.most_nms.sum())
    if held and not estimator.momentum_sigma_nms:
        estimator = estimator.model_copy(update={"momentum_sigma_nms": held})
    return config.model_copy(update={"joints": tuple(joints), "estimator": estimator})


def _of_parts(flight: _Flight) -> Iterator[Cost]:
    """Yield the cost of what the base carries, as it works along the motion."""
    fired_s = sum(firing.for_s for firing in flight.trajectory.firings)
    values = channels(flight.blocks, flight.problem)
    for kind in ON_BASE:
        for rest, words in kind.left_out(flight.config, fired_s):
            left = flight.without(kind.section, values, rest)
            yield _cost(*left, words, kind.section, is_modelled=True)


def _of_unknown_firing(flight: _Flight) -> Iterator[Cost]:
    config, problem, motion = flight.config, flight.problem, flight.trajectory
    found = firings.of_strongest(config, 0.5 * motion.duration_s, FIRING_S)
    if found is not None and config.estimator.outside_wrench == "ignore":
        fired = replace(motion, firings=(*motion.firings, found[0]))
        shift = flight.unknown(channels(blocks_along(config, problem, fired), problem))
        words = f"an unknown firing of {found[1]:.3g} N for {FIRING_S:g} s"
        yield _cost(problem, shift, words, "estimator.outside_wrench", is_modelled=False)


def _of_orbit(flight: _Flight) -> Iterator[Cost]:
    """Yield the cost of a low orbit if none is configured: the worst of three inclined planes."""
    config, problem, model = flight.config, flight.problem, flight.problem.model
    if config.base.motion != "free" or config.orbit is not None:
        return
    model.set_parameters(problem.pi(problem.prior_mean))
    H = model.mass_matrix(flight.blocks[0].q_rad[0])[:6, :6]
    moments = np.linalg.eigvalsh(H[3:, 3:] - H[3:, :3] @ H[:3, 3:] / H[0, 0])
    size_nm = 1.5 * LOW_ORBIT_RAD_S**2 * (moments[-1] - moments[0])
    oriented = [replace(block, has_attitude=True) for block in flight.blocks]
    radius_m = (EARTH_GRAVITY_PARAMETER_M3_S2 / LOW_ORBIT_RAD_S**2) ** (1.0 / 3.0)
    shifts = []
    for axis in range(3):
        up = np.roll([0.0, 1.0, 1.0], axis) / np.sqrt(2.0)
        orbit = OrbitConfig(
            position_m=tuple(radius_m * up),
            velocity_m_s=tuple(radius_m * LOW_ORBIT_RAD_S * np.eye(3)[axis]),
        )
        there = config.model_copy(update={"orbit": orbit})
        shifts.append(flight.unknown(channels(oriented, problem_of(there, model))))
    worst = max(shifts, key=lambda shift: float(np.max(np.abs(_masses(problem, shift)[1]))))
    words = f"gravity gradient, in low orbit up to {size_nm:.2g} N m on the whole"
    yield _cost(problem, worst, words, "orbit", is_modelled=False)


def _of_delays(flight: _Flight) -> Iterator[Cost]:
    imu, n = flight.config.imu, len(flight.problem.model.torque_units)
    values = channels(flight.blocks, flight.problem)
    for name, key, delay_s, first in (
        ("accelerometer", "acc_group_delay_s", imu.acc_group_delay_s, n),
        ("gyro", "gyro_group_delay_s", imu.gyro_group_delay_s, n + 3),
    ):
        if imu.present and delay_s:
            delays_s = np.zeros(n + 6)
            delays_s[first : first + 3] = delay_s
            shift = flight.unknown(
                [
                    late(own, delays_s, 1e-9 * half_ns(block))
                    for block, own in zip(flight.blocks, values, strict=True)
                ]
            )
            words = f"group delay of {name}, {1e3 * delay_s:.3g} ms"
            yield _cost(flight.problem, shift, words, f"imu.{key}", is_modelled=True)


def _masses(problem: Problem, shift: Shift) -> tuple[FloatArray, FloatArray]:
    """Return the mass error of every unknown body [kg], and the same in predicted sigmas."""
    masses = np.arange(len(problem.unknown)) * PARAMETERS
    return shift.error[masses], shift.error[masses] / shift.sigma[masses]


def _cost(problem: Problem, shift: Shift, effect: str, key: str, *, is_modelled: bool) -> Cost:
    kg, sigmas = np.abs(_masses(problem, shift))
    return Cost(
        effect=effect,
        key=key,
        is_modelled=is_modelled,
        mass_kg=tuple(kg.tolist()),
        sigmas=tuple(sigmas.tolist()),
    )
