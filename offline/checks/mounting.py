"""Find values of arm and calibration that the data contradict, and name the configuration keys.

Place and attitude of the inertial unit are states of the estimator, so wrong values leave small
residuals. Only the distance of these states from their prior shows the mistake.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import CONSPICUOUS, Problem
from fsw.estimators.model.state_groups import BY_NAME, GROUPS
from fsw.messages import FloatArray

MOUNTING = {group.name: group for group in GROUPS if group.doubt}


def with_doubtful_mounting(config: Config, problem: Problem) -> Problem:
    """Return the problem with place and attitude of the inertial unit, if any, as states."""
    if not config.imu.present or all(map(problem.has, MOUNTING)):
        return problem
    imu = config.imu.model_dump()
    for group in MOUNTING.values():
        imu[group.field] = imu[group.field] or group.doubt
    return build_problem(config.with_sections(imu=imu), problem.model)


def with_free_mounting(problem: Problem) -> Problem:
    """Return the problem with a prior so wide that the inertial unit's mounting is unknown."""
    covariance = problem.prior_covariance.copy()
    for name, group in MOUNTING.items():
        states = problem.at(name)
        covariance[states] = 0.0
        covariance[:, states] = 0.0
        covariance[states, states] = group.unknown**2 * np.eye(states.stop - states.start)
    return replace(problem, prior_covariance=covariance)


def contradicted(problem: Problem, x: FloatArray) -> str:
    """Return the kind of the state x (p,) farthest from its prior; empty: all are near."""
    name, sigmas = problem.least_plausible(x)
    return name.partition(".")[0] if sigmas > CONSPICUOUS else ""


def mounting_words(config: Config, problem: Problem, x: FloatArray) -> str:
    """Return in words wrong keys of the mounting and their likely values; empty: none is wrong."""
    place, angle = x[problem.at("imu_place")], x[problem.at("imu_angle")]
    root = np.sqrt(np.diag(problem.prior_covariance))
    states = problem.at("imu_place"), problem.at("imu_angle")
    sigmas = [float(np.max(np.abs(x[s]) / root[s], initial=0.0)) for s in states]
    told = []
    if sigmas[1] > CONSPICUOUS:
        true = Rotation.from_rotvec(angle) * Rotation.from_quat(config.imu.mounting.q_BS_xyzw)
        degrees = float(np.rad2deg(np.linalg.norm(angle)))
        told.append(
            f"imu.mounting: the unit is turned by {degrees:.3g} degrees against its configured "
            f"attitude ({sigmas[1]:.0f} sigma); q_BS_xyzw is near "
            f"[{', '.join(f'{v:.3f}' for v in true.as_quat())}]"
        )
    if sigmas[0] > CONSPICUOUS:
        near = ", ".join(f"{v:.3f}" for v in problem.p_BS_m + place)
        told.append(
            f"imu.mounting.p_BS_m: the unit is {np.linalg.norm(place):.2g} m from its configured "
            f"place ({sigmas[0]:.0f} sigma); it is near [{near}]"
        )
    return "; ".join(told)


def other_words(problem: Problem, x: FloatArray) -> str:
    """Return in words which value of arm or calibration is farthest from its prior."""
    name, sigmas = problem.least_plausible(x)
    kind, _, label = name.partition(".")
    what = BY_NAME[kind].mistake or kind
    words = f"{what} ({label}) is estimated {sigmas:.0f} sigma from what is configured"
    return f"{words}: it is wrong, or what looks like it, such as a link's mass or a delay"
