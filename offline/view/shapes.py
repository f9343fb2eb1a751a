"""Shapes of a scene as triangles: visual shapes or capsules of links, and boxes of bodies."""

from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray, IntArray
from planner.collision import read_geometry

MOST_TRIANGLES = 20_000  # most triangles of a mesh; a finer mesh is drawn as its convex hull
TURN = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
THICKNESS = 0.025  # ratio of a link's drawn radius to the reach
LINK, BASE, BODY = "#5b6570", "#8fa6bd", "#c9b037"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """Triangles fixed to the base (frame 0) or to the link of joint `frame` - 1, in its frame."""

    frame: int
    vertices_m: FloatArray  # (v, 3)
    faces: IntArray  # (f, 3) indices of vertices
    colour: str
    opacity: float = 1.0


def ball(radius_m: float) -> FloatArray:
    """Return points (k, 3) [m] on a sphere about the origin."""
    height = np.cos(np.linspace(0.0, np.pi, 13))
    ring = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)
    points = [np.c_[np.sqrt(1.0 - z * z) * ring, np.full(len(ring), z)] for z in height]
    return radius_m * np.unique(np.round(np.concatenate(points), 9), axis=0)


def hull(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return vertices (v, 3) and faces (f, 3), outward by the right-hand rule, of a hull."""
    found = ConvexHull(points)
    corners = points[found.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_inward = np.einsum("ij,ij->i", normal, found.equations[:, :3]) < 0.0
    faces = found.simplices.copy()
    faces[is_inward] = faces[is_inward][:, ::-1]
    used, places = np.unique(faces, return_inverse=True)
    return points[used], places.reshape(faces.shape)


def box_of(mass_kg: float, com_m: FloatArray, inertia_kg_m2: FloatArray) -> FloatArray:
    """Return the corners (8, 3) [m] of the homogeneous box with this mass and inertia."""
    xx, xy, xz, yy, yz, zz = inertia_kg_m2
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    half = np.sqrt(np.maximum(1.5 / mass_kg * (moments.sum() - 2.0 * moments), 1e-8))
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(com_m + (signs * half) @ axes.T)


def frame_of(model: RobotModel, name: str) -> tuple[int, pin.SE3]:
    """Return what carries a URDF frame (0: base, k: link of joint k - 1), and its pose there."""
    frame = model.model.frames[model.frame_id(name, "robot.tool_frame")]
    return int(frame.parentJoint) - 1, frame.placement


def reach_m(model: RobotModel, tool_frame: str) -> float:
    """Return the longest path [m] from the base along the joints, to a joint or to the tool."""
    ways_m = [0.0]
    for parent, step_m in zip(model.parents.tolist(), model.steps_m(), strict=True):
        ways_m.append(ways_m[parent] + step_m)
    carrier, place = frame_of(model, tool_frame)
    return max(*ways_m, ways_m[carrier] + float(np.linalg.norm(place.translation))) or 1.0


def visuals(model: RobotModel, urdf: Path) -> list[Shape]:
    """Return the visual shapes of the URDF.

    Raises
    ------
    ConfigError if a mesh cannot be read.
    """
    visual = read_geometry(model, urdf, pin.GeometryType.VISUAL)
    return [_visual(item) for item in visual.geometryObjects]


def _visual(item: pin.GeometryObject) -> Shape:
    place = item.placement
    vertices, faces = _triangles(item.geometry)
    vertices = vertices @ place.rotation.T + place.translation
    red, green, blue, alpha = np.clip(item.meshColor, 0.0, 1.0)
    colour = "#" + "".join(f"{round(255 * x):02x}" for x in (red, green, blue))
    return Shape(
        frame=int(item.parentJoint) - 1,
        vertices_m=vertices,
        faces=faces,
        colour=colour,
        opacity=float(alpha) or 1.0,
    )


def _triangles(solid: coal.CollisionGeometry) -> tuple[FloatArray, IntArray]:
    if isinstance(solid, coal.Box):
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        return hull(signs * np.asarray(solid.halfSide))
    if isinstance(solid, coal.Sphere):
        return hull(ball(solid.radius))
    if isinstance(solid, coal.Cylinder | coal.Capsule):
        ends = np.array([[0.0, 0.0, -solid.halfLength], [0.0, 0.0, solid.halfLength]])
        ring = solid.radius * np.c_[np.cos(TURN), np.sin(TURN), np.zeros(len(TURN))]
        cap = ring if isinstance(solid, coal.Cylinder) else ball(solid.radius)
        return hull(np.concatenate([end + cap for end in ends]))
    vertices = np.asarray(solid.vertices())
    if solid.num_tris > MOST_TRIANGLES:
        return hull(vertices)
    corners = [solid.tri_indices(k) for k in range(solid.num_tris)]
    return vertices, np.array([[c[0], c[1], c[2]] for c in corners])


def capsules(model: RobotModel, tool_frame: str) -> list[Shape]:
    """Return a capsule from each joint to the next, and from the last joint to the tool frame."""
    end = ball(THICKNESS * reach_m(model, tool_frame))
    steps = [
        (parent, np.asarray(place.translation))
        for parent, place in zip(
            model.parents.tolist(), list(model.model.jointPlacements)[2:], strict=True
        )
    ]
    carrier, place = frame_of(model, tool_frame)
    steps.append((carrier, np.asarray(place.translation)))
    shapes = []
    for frame, far in steps:
        vertices, faces = hull(np.concatenate([end, far + end]))
        shapes.append(Shape(frame=frame, vertices_m=vertices, faces=faces, colour=LINK))
    return shapes
