"""Distances between bodies with collision geometry, and their derivatives by joint positions.

The geometry is that of the URDF, with a box for the grasped target if the limits define one.
Pinocchio and coal compute the distances. Pairs on one link or on neighbouring links, which touch by
design, are left out.
"""

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from fsw.errors import ConfigError
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from planner.limits import TargetBox


class Collisions:
    """The pairs of bodies that may collide; `names` are the names of the pairs."""

    def __init__(self, geometry: pin.GeometryModel, model: RobotModel) -> None:
        self._model, self._geometry = model.model, geometry
        self._data, self._distances = model.model.createData(), pin.GeometryData(geometry)
        objects = list(geometry.geometryObjects)
        self._pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        self.names = tuple(f"{objects[a].name} to {objects[b].name}" for a, b in self._pairs)
        self._parents = [int(item.parentJoint) for item in objects]

    def distances(
        self, q_rad: FloatArray, *, derivatives: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the pairs' distances (m, k) [m], negative if they overlap, and d/dq (m, k, n).

        The derivative is that of the nearest points along the line between them. It is zero unless
        `derivatives` is set.
        """
        n = self._model.nv - 6
        values = np.empty((len(q_rad), len(self._pairs)))
        slopes = np.zeros((len(q_rad), len(self._pairs), n))
        pose = pin.neutral(self._model)
        for i, q in enumerate(q_rad):
            pose[7:] = q
            if derivatives:
                pin.computeJointJacobians(self._model, self._data, pose)
            pin.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._distances, pose
            )
            for k, (a, b) in enumerate(self._pairs):
                found = pin.computeDistance(self._geometry, self._distances, k)
                values[i, k] = found.min_distance
                if derivatives:
                    slopes[i, k] = self._slope(found, a, b)
        return values, slopes

    def _slope(self, found: coal.DistanceResult, a: int, b: int) -> FloatArray:
        first, second = found.getNearestPoint1(), found.getNearestPoint2()
        normal = np.asarray(found.normal)  # from the first to the second
        if not np.all(np.isfinite(normal)):
            return np.zeros(self._model.nv - 6)
        motion = self._point_jacobian(b, second) - self._point_jacobian(a, first)
        return np.asarray(normal @ motion[:, 6:])

    def _point_jacobian(self, item: int, point: FloatArray) -> FloatArray:
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        joint = self._parents[item]
        J = pin.getJointJacobian(self._model, self._data, joint, frame)
        arm = point - self._data.oMi[joint].translation
        return np.asarray(J[:3] - pin.skew(arm) @ J[3:])


def read_geometry(model: RobotModel, urdf: Path, kind: pin.GeometryType) -> pin.GeometryModel:
    """Return the URDF's shapes of a kind, COLLISION or VISUAL.

    Raises
    ------
    ConfigError if a mesh cannot be read.
    """
    try:
        return pin.buildGeomFromUrdf(model.model, str(urdf), kind, package_dirs=[str(urdf.parent)])
    except (ValueError, RuntimeError) as error:
        words = " ".join(str(error).rpartition("message: ")[2].split())
        raise ConfigError(f"robot.urdf: {urdf}: {kind.name.lower()} geometry: {words}") from error


def build_collisions(
    model: RobotModel, urdf: Path, tool_frame: str, target: TargetBox | None
) -> Collisions | None:
    """Return the pairs to check, or None when the URDF has no collision geometry.

    Raises
    ------
    ConfigError if a mesh cannot be read.
    """
    geometry = read_geometry(model, urdf, pin.GeometryType.COLLISION)
    if target is not None:
        frame = model.model.frames[model.frame_id(tool_frame, "robot.tool_frame")]
        place = frame.placement * pin.SE3(np.eye(3), np.array(target.center_m))
        box = coal.Box(*target.size_m)
        geometry.addGeometryObject(pin.GeometryObject("target", frame.parentJoint, place, box))
    objects = list(geometry.geometryObjects)
    for a, first in enumerate(objects):
        for b in range(a + 1, len(objects)):
            second = objects[b]
            if not _joined(model.model, int(first.parentJoint), int(second.parentJoint)):
                geometry.addCollisionPair(pin.CollisionPair(a, b))
    return Collisions(geometry, model) if len(geometry.collisionPairs) else None


def _joined(model: pin.Model, a: int, b: int) -> bool:
    """Return whether two bodies, given by their joints, are on the same or neighbouring links."""
    return a == b or int(model.parents[a]) == b or int(model.parents[b]) == a
