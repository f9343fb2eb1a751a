"""A scene as plain values for the page: parts, their motion, and ellipsoids of centres of mass."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from offline.view.bodies import Guess, ellipsoid, magnification
from offline.view.motion import Motion
from offline.view.shapes import Shape

DIGITS = 9  # significant digits of all numbers of a scene


def frames(model: RobotModel, motion: Motion) -> list[dict[str, Any]]:
    """Return position [m] and attitude (xyzw) in N over time of the base and each joint's link."""
    data = model.model.createData()
    quaternion = Rotation.from_matrix(motion.R_NB).as_quat()
    poses = np.empty((len(motion.t_s), model.n + 1, 3, 4))
    for k, q in enumerate(np.c_[motion.p_NB_m, quaternion, motion.q_rad]):
        pin.forwardKinematics(model.model, data, q)
        for frame, pose in enumerate(list(data.oMi)[1:]):
            poses[k, frame] = pose.homogeneous[:3]
    return [
        {
            "path": path_of(model, frame),
            "t": numbers(motion.t_s),
            "p": numbers(own[:, :, 3]),
            "q": numbers(Rotation.from_matrix(own[:, :, :3]).as_quat()),
        }
        for frame, own in enumerate(poses.transpose(1, 0, 2, 3))
    ]


def parts(model: RobotModel, shapes: Sequence[Shape]) -> list[dict[str, Any]]:
    """Return the shapes as parts of the scene, each with path, triangles and colour."""
    return [
        {
            "path": f"{path_of(model, shape.frame)}/part{number}",
            "vertices": numbers(shape.vertices_m),
            "faces": shape.faces.ravel().tolist(),
            "colour": shape.colour,
            "opacity": shape.opacity,
        }
        for number, shape in enumerate(shapes)
    ]


def centre(
    path: str, name: str, place: pin.SE3, known: Sequence[Guess], reach_m: float
) -> dict[str, Any]:
    """Return a body's centre of mass over time, with its ellipsoid, in the frame of its link.

    Parameters
    ----------
    place : pose of the body's frame in the frame of the link at `path`
    """
    axes, rows = np.eye(3), []
    for guess in known:
        axes, semi_m = ellipsoid(guess.covariance_m2, axes)
        rows.append((place.rotation @ axes, semi_m, magnification(semi_m, reach_m)))
    com = np.array([guess.body.com_m for guess in known])
    return {
        "name": name,
        "path": path,
        "t": numbers(np.array([guess.t_s for guess in known])),
        "p": numbers(com @ place.rotation.T + place.translation),
        "q": numbers(Rotation.from_matrix(np.array([row[0] for row in rows])).as_quat()),
        "semi": numbers(np.array([row[1] for row in rows])),
        "times": [row[2] for row in rows],
        "reasons": [guess.reason for guess in known],
        "mass": numbers(np.array([[g.body.mass_kg, g.body.mass_sigma_kg] for g in known])),
        "com": numbers(com),
        "sigma": numbers(np.array([guess.body.com_sigma_m for guess in known])),
    }


def with_truth(
    shown: Mapping[str, Any], place: pin.SE3, truth: FloatArray | None
) -> dict[str, Any]:
    """Return `shown` with the true mass [kg] and centre of mass [m] of `truth` (4,), if given."""
    if truth is None:
        return dict(shown)
    p = place.rotation @ truth[1:] + place.translation
    return {**shown, "truth": {"mass": float(truth[0]), "com": numbers(truth[1:]), "p": numbers(p)}}


def path_of(model: RobotModel, frame: int) -> str:
    """Return the path in the scene's tree of the base (0) or of the link of joint `frame` - 1."""
    name = "base" if frame == 0 else model.joint_names[frame - 1]
    return f"/robot/{name.replace('/', '_')}"


def numbers(values: FloatArray) -> list[float]:
    """Return the values as a flat list, rounded to DIGITS significant digits."""
    return [float(f"{x:.{DIGITS}g}") for x in np.ravel(values)]
