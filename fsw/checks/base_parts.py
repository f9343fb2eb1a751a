"""Check that the base remains a possible body without the modes and rotors that belong to it."""

from collections.abc import Iterator

import numpy as np

from fsw.config import Config
from fsw.estimators.model.inertia import PARAMETERS, from_parameters, is_consistent
from fsw.estimators.model.modes import in_base
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray


def part_faults(config: Config, problem: Problem) -> list[str]:
    """Return a line for the first mode and for each wheel that the base cannot contain."""
    base = problem.pi(problem.prior_mean)[:PARAMETERS]
    return [*_mode_fault(config, base), *_rotor_faults(config, base)]


def _mode_fault(config: Config, base: FloatArray) -> Iterator[str]:
    """Yield a line for the first mode without which the base (10,) is no possible body."""
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
        moments = _principal(from_parameters(rest)[2])
        yield (
            f"{at}which without it, at p_B_m {list(mode.p_B_m)}, would have the principal moments "
            f"{moments.round(3).tolist()} kg m^2; must be positive, each below the sum of the "
            "other two"
        )
        return


def _rotor_faults(config: Config, base: FloatArray) -> Iterator[str]:
    """Yield a line for each rotor with at least the inertia of the base (10,) about its axis."""
    if config.base.motion != "free" or base[0] <= 0.0:
        return
    central = _matrix(from_parameters(base)[2])
    for i, wheel in enumerate(config.wheels):
        axis = np.array(wheel.axis_B)
        most = float(axis @ central @ axis)
        if wheel.inertia_kg_m2 >= most:
            yield (
                f"wheels.{i}.inertia_kg_m2: {wheel.inertia_kg_m2:g} ({wheel.name}); locked it "
                f"belongs to base; must be below its inertia about the wheel's axis, {most:.4g}"
            )


def _matrix(inertia_kg_m2: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of the inertia xx xy xz yy yz zz."""
    xx, xy, xz, yy, yz, zz = inertia_kg_m2
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _principal(inertia_kg_m2: FloatArray) -> FloatArray:
    """Return the principal moments (3,) [kg m^2] in ascending order."""
    return np.asarray(np.linalg.eigvalsh(_matrix(inertia_kg_m2)))
