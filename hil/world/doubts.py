"""Truth that differs from what the flight side declares, within the sigmas that it declares."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hil.world.base_urdf import change_links
from hil.world.inertia import FloatArray, is_physical, six_of, symmetric
from hil.world.links import read_links
from hil.world.sensor_config import Quaternion


def spread(report: FloatArray, S: FloatArray) -> FloatArray:
    """Return the report of the body whose pseudo-inertia is L (1 + S) L^T, with P = L L^T its own.

    P has the mass first. S (4, 4) is symmetric; S[0, 0] is the relative change of the mass.
    """
    mass, com, central = report[0], report[1:4], symmetric(report[4:])
    moments = 0.5 * np.trace(central) * np.eye(3) - central + mass * np.outer(com, com)
    L = np.linalg.cholesky(np.block([[mass, mass * com], [mass * com[:, None], moments]]))
    P = L @ (np.eye(4) + S) @ L.T
    com = P[0, 1:] / P[0, 0]
    moments = P[1:, 1:] - P[0, 0] * np.outer(com, com)
    central = np.trace(moments) * np.eye(3) - moments
    return np.concatenate([[P[0, 0]], com, six_of(central)])


def drawn_body(report: FloatArray, ratio: float, rng: np.random.Generator) -> FloatArray:
    """Return a body drawn about a report (10,), within `ratio` as `links_sigma_ratio` defines it.

    A body without extent in some direction is returned unchanged.
    """
    while is_physical(report) and ratio > 0.0:
        N = rng.standard_normal((4, 4))
        drawn = spread(report, 0.5 * ratio * (N + N.T))
        if is_physical(drawn):
            return drawn
    return report


def drawn_links(
    urdf: Path, ratios: Mapping[str, float], seeded: Callable[[int], np.random.Generator]
) -> str:
    """Return a URDF's text in which every link but the root is drawn.

    Parameters
    ----------
    ratios : ratio by name of the joint that moves a link; "": of links that are fixed to the root
    seeded : returns the random stream of a link by its number
    """
    joint_of: dict[str, str] = {}
    changes = {}
    for number, link in enumerate(read_links(urdf)):
        moving = "" if link.parent is None else joint_of[link.parent]
        joint_of[link.name] = moving if link.axis is None else link.joint
        if link.parent is not None:
            ratio = ratios[joint_of[link.name]]
            changes[link.name] = partial(drawn_body, ratio=ratio, rng=seeded(number))
    return change_links(urdf.read_text(encoding="utf-8"), changes)


def turned(q_BS_xyzw: Quaternion, angle_rad: FloatArray) -> list[float]:
    """Return the quaternion of a sensor that is turned about its own axes by small angles (3,)."""
    found: list[float] = (
        (Rotation.from_quat(q_BS_xyzw) * Rotation.from_rotvec(angle_rad)).as_quat().tolist()
    )
    return found
