"""Check the robot of a configuration: readable URDF, usable joints, physically possible bodies."""

import os
from collections.abc import Iterator
from math import inf, tau
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np

from fsw.checks.urdf import check_urdf
from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.effects.registered import ON_BASE
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.model.inertia import PARAMETERS, pseudo_inertia
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray

ROOT_LINK = "the root link"
CURES = {  # of what the URDF library complains of
    "Two root links": "; join them by a joint, or remove one",
    "is not unique": "; give every link and joint a name of its own",
    "to a double": "; a number has a decimal point and no unit",
}
MOST_SPEED_RAD_S = 1e3  # limits above these bounds are placeholders
MOST_EFFORT_NM = 1e5
MOST_TURN_RAD = 1e4
WIDE_M = 50.0  # a wider link probably has an inertia in kg mm^2 or a mass in tonnes
DENSE_KG_M3 = 25_000.0  # denser than osmium: the mass is probably in grams
TURNS_RAD = 2.0 * tau  # a joint limit above this, up to MOST_DEGREES, is probably in degrees
MOST_DEGREES = 720.0  # joints that may turn endlessly have wider limits
FAR_M = 10.0  # a larger distance of two joints is probably in millimetres or centimetres


def load_problem(config: Config) -> Problem:
    """Read the robot model and return the estimation problem of a configuration.

    Raises
    ------
    ConfigError when robot, tool frame, joints or bodies do not suit each other.
    """
    urdf = config.resolve(config.robot.urdf)
    _check_urdf(urdf)
    _check_masses(config, read_model(urdf, config.robot.tool_frame))
    problem = build_problem(config, robot_of(config), exact=config.estimator.is_regression)
    base = problem.pi(problem.prior_mean)[:PARAMETERS]
    if faults := [line for kind in ON_BASE for line in kind.faults(config, base)]:
        raise ConfigError("\n".join(faults))
    return problem


def read_model(urdf: Path, tool_frame: str) -> RobotModel:
    """Return the robot model; errors that the URDF library only prints count as faults.

    Raises
    ------
    ConfigError when this software cannot use the model.
    """
    with TemporaryFile() as said:
        stderr = os.dup(2)
        try:
            os.dup2(said.fileno(), 2)
            model = RobotModel(urdf, tool_frame)
        except ConfigError as error:
            raise ConfigError(_library_words(said, urdf) or str(error)) from error
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        complaint = _library_words(said, urdf)
    if complaint:
        raise ConfigError(complaint)
    return model


def _library_words(said: IO[bytes], urdf: Path) -> str:
    """Return the first error that the URDF library printed, as one line; empty: no error."""
    said.seek(0)
    for line in said.read().decode(errors="replace").splitlines():
        if line.startswith("Error:"):
            words = line.removeprefix("Error:").strip().rstrip(".")
            cure = next((cure for found, cure in CURES.items() if found in words), "")
            return f"robot.urdf: {urdf} cannot be used: {words}{cure}"
    return ""


def _check_urdf(urdf: Path) -> None:
    try:
        check_urdf(urdf.read_bytes())
    except OSError as error:
        raise ConfigError(f"robot.urdf: {urdf} cannot be read: {error.strerror}") from error
    except ConfigError as error:
        raise ConfigError(f"robot.urdf: {urdf} {error}") from error
    except ValueError as error:  # a zero byte in the name
        raise ConfigError(f"robot.urdf: {str(urdf)!r} is not a file name: {error}") from error


def _check_masses(config: Config, model: RobotModel) -> None:
    count = len(config.joints)
    if model.n == 0 and count:
        raise ConfigError(f"robot.urdf: 0 joints that move; must be the {count} of joints")
    for link, pi in _known_links(config, model):
        if pi[0] < 0.0 or (pi[0] == 0.0 and link == ROOT_LINK):
            bound = "at least 0"
            if link == ROOT_LINK:
                bound = "positive, or bodies.base given, or base.motion clamped"
            raise ConfigError(f"robot.urdf: {link} has mass {pi[0]:g} kg; must be {bound}")


def inertia_warnings(config: Config, model: RobotModel) -> list[str]:
    """Return a line for each known link or joint whose data are implausible for a robot."""
    massless = [
        f"robot.urdf: {link} has no mass; is its <inertial> missing?"
        for link, pi in _known_links(config, model)
        if pi[0] == 0.0
    ]
    far = [
        f"robot.urdf: the joint {name!r} is {distance_m:.3g} m from the one before it; a URDF is "
        "in metres"
        for name, distance_m in zip(model.joint_names, model.steps_m(), strict=True)
        if distance_m > FAR_M
    ]
    wide = [
        f"robot.urdf: {link} (mass {pi[0]:g} kg) has the inertia of a body {size_m:.3g} m across; "
        "a URDF is in kg m^2 and kg"
        for link, pi in _known_links(config, model)
        if pi[0] > 0.0 and (size_m := _size_m(pi)) > WIDE_M
    ]
    dense = [
        f"robot.urdf: {link} (mass {pi[0]:g} kg) is denser than any metal by its inertia; is the "
        "mass in grams? a URDF is in kg m^2 and kg"
        for link, pi in _known_links(config, model)
        if pi[0] > 0.0 and pi[0] > DENSE_KG_M3 * _size_m(pi) ** 3 > 0.0
    ]
    own = model.model
    lower, upper = own.lowerPositionLimit[7:].tolist(), own.upperPositionLimit[7:].tolist()
    turning = [
        f"robot.urdf: the joint {name!r} has limits of {low:g} to {high:g} rad; are these degrees? "
        "a URDF is in radians"
        for name, kind, low, high in zip(
            model.joint_names, model.kinds(), lower, upper, strict=True
        )
        if kind == "revolute" and TURNS_RAD < max(-low, high) <= MOST_DEGREES
    ]
    return [
        *massless,
        *_placeholders(model),
        *turning,
        *far,
        *wide,
        *dense,
        *_impossible(config, model),
    ]


def _placeholders(model: RobotModel) -> Iterator[str]:
    """Yield a line for each joint with limits that no joint has; `fsw excite` must keep them."""
    own = model.model
    for k, (name, kind) in enumerate(zip(model.joint_names, model.kinds(), strict=True)):
        low, high = float(own.lowerPositionLimit[7 + k]), float(own.upperPositionLimit[7 + k])
        speed, effort = float(own.velocityLimit[6 + k]), float(own.effortLimit[6 + k])
        unit = "rad" if kind == "revolute" else "m"
        words = [
            f"{key} {value:g}"
            for key, value, most in (
                ("velocity", speed, MOST_SPEED_RAD_S),
                ("effort", effort, MOST_EFFORT_NM),
            )
            if not 0.0 < value <= most
        ]
        is_endless = low == -inf and high == inf  # so is that of a continuous joint
        if low >= high or (max(-low, high) > MOST_TURN_RAD and not is_endless):
            words.append(f"a range of {low:g} to {high:g} {unit}")
        if words:
            yield (
                f"robot.urdf: the joint {name!r} has {' and '.join(words)} in its <limit>; are "
                "these placeholders? fsw excite keeps them"
            )


def _impossible(config: Config, model: RobotModel) -> list[str]:
    return [
        f"robot.urdf: {link} (mass {pi[0]:g} kg) has an inertia that no body can have: principal "
        "moments must be positive, each at most the sum of the other two"
        for link, pi in _known_links(config, model)
        if pi[0] > 0.0 and not _possible(pi)
    ]


def _known_links(config: Config, model: RobotModel) -> list[tuple[str, FloatArray]]:
    """Return name and parameters (10,) of each URDF link whose inertia has an effect.

    That of the root has none where bodies.base replaces it, or it has no mass and is clamped.
    """
    names = [ROOT_LINK, *(f"the link moved by {name!r}" for name in model.joint_names)]
    links = list(zip(names, model.pi_links.reshape(-1, PARAMETERS), strict=True))
    is_ground = config.base.motion == "clamped" and links[0][1][0] == 0.0
    return links[1:] if "base" in config.bodies or is_ground else links


def _size_m(pi: FloatArray) -> float:
    """Return the side [m] of a cube with the mass and mean central moment of the body pi (10,)."""
    central = pi[[4, 6, 9]].sum() - 2.0 * float(pi[1:4] @ pi[1:4]) / pi[0]
    return float(np.sqrt(6.0 * max(central / 3.0, 0.0) / pi[0]))


def _possible(pi: FloatArray) -> bool:
    """Return whether a body with parameters pi (10,) is possible, point or thin rod included."""
    moments = np.linalg.eigvalsh(pseudo_inertia(pi))
    return bool(moments[0] >= -1e-9 * moments[-1])
