"""Surface meshes of colliders that a run's scene describes by shapes."""

from typing import NamedTuple

import numpy as np

SEGMENTS = 48  # faces around an axis


class ColliderMesh(NamedTuple):
    """Surface of a collider at rest.

    Attributes:
        name: Name of the object.
        points: Vertices, shape (m, 3) [m].
        faces: Vertices of each face, counterclockwise from outside.
        color: Color in 0..1.
        pose: Index of its pose in the frames, -1 if it does not move.
    """

    name: str
    points: np.ndarray
    faces: list[list[int]]
    color: list[float]
    pose: int


def collider_meshes(objects: list[dict], scene: dict) -> tuple[list[ColliderMesh], list[str]]:
    """Return the meshes of a run's colliders, and the names of colliders without one.

    Args:
        objects: Objects of gaussians.h5.
        scene: Scene of gaussians.h5.
    """
    shapes = {entry.get("name"): entry.get("shape") or {} for entry in scene.get("object", [])}
    meshes, names, pose = [], [], -1
    for entry in objects:
        pose += bool(entry.get("is_moving"))
        if not entry.get("collider"):
            continue
        name = str(entry.get("name"))
        surface = _shape_surface(shapes.get(name, {}))
        if surface is None:
            names.append(name)
            continue
        points, faces = surface
        matrix = np.array(entry["transform"], dtype=np.float64)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
        color = [float(value) for value in entry.get("color") or (0.7, 0.7, 0.7)]
        number = pose if entry.get("is_moving") else -1
        meshes.append(ColliderMesh(name, points, faces, color, number))
    return meshes, names


def _shape_surface(shape: dict) -> tuple[np.ndarray, list[list[int]]] | None:
    """Return vertices and faces of a shape, or None if it is no union of primitive shapes.

    The surfaces of a union's parts stand beside each other, also where they overlap.
    """
    form = next((key for key in _SURFACES if shape.get(key) is not None), None)
    if form is not None:
        return _SURFACES[form](shape[form])
    points: list[np.ndarray] = []
    faces: list[list[int]] = []
    for part in shape.get("union") or ():
        surface = _shape_surface(part)
        if surface is None:
            return None
        first = sum(map(len, points))
        points.append(surface[0])
        faces += [[first + index for index in face] for face in surface[1]]
    return (np.concatenate(points), faces) if points else None


def _box(corners: list) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a box with two corners (3,)."""
    low, high = np.array(corners, dtype=np.float64)
    corner = np.indices((2, 2, 2)).reshape(3, -1).T
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return low + corner * (high - low), faces


def _ellipsoid(center: list, radii: list) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of an ellipsoid with axes along x, y and z."""
    height, across = _arc(0.0, np.pi)
    points, faces = _revolve(height, across, np.zeros(3), np.array([0, 0, 1.0]))
    return np.array(center) + points * radii, faces


def _cone(endpoints: list, radii: list) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a cylinder or a cone with a radius at each end of its axis."""
    start, axis = _axis(endpoints)
    length = np.linalg.norm(axis)
    height, across = np.array([0, 0, length, length]), np.array([0, radii[0], radii[1], 0.0])
    return _revolve(height, across, start, axis / length)


def _capsule(endpoints: list, radius: float) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a cylinder with round ends."""
    start, axis = _axis(endpoints)
    length = np.linalg.norm(axis)
    ends = (_arc(0.0, np.pi / 2), _arc(np.pi / 2, np.pi))
    height = np.concatenate([radius * ends[0][0], length + radius * ends[1][0]])
    across = radius * np.concatenate([ends[0][1], ends[1][1]])
    return _revolve(height, across, start, axis / length)


def _torus(shape: dict) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a ring."""
    height, across = shape["minor_radius"] * np.array(_arc(0.0, 2 * np.pi))
    across += shape["major_radius"]
    return _revolve(height, across, np.array(shape["center"]), np.array(shape["axis"]))


def _axis(endpoints: list) -> tuple[np.ndarray, np.ndarray]:
    """Return the first end of an axis and the vector to the second one, (3,) each."""
    start, end = np.array(endpoints, dtype=np.float64)
    return start, end - start


def _arc(first: float, last: float) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and distances from the axis of a unit circle, from its lower end on."""
    angle = np.linspace(first, last, round(SEGMENTS * (last - first) / (2 * np.pi)) + 1)
    return -np.cos(angle), np.round(np.sin(angle), 15)  # exactly 0 on the axis


def _revolve(
    height: np.ndarray, across: np.ndarray, origin: np.ndarray, axis: np.ndarray
) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of the surface of a profile that turns about an axis.

    Args:
        height: Profile along the axis, upwards, its inside on the side of the axis, shape (n,) [m].
        across: Distance of the profile from the axis, shape (n,) [m].
        origin: Point on the axis at height 0, shape (3,) [m].
        axis: Unit vector, shape (3,).
    """
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    turns = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    circle = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), np.cross(axis, first))
    points = origin + height[:, None, None] * axis + across[:, None, None] * circle
    vertex = np.arange(points[..., 0].size).reshape(len(height), SEGMENTS)
    vertex[across == 0] = vertex[across == 0][:, :1]  # one vertex on the axis
    if height[0] == height[-1] and across[0] == across[-1]:  # the profile is closed
        vertex[-1] = vertex[0]
    turned = np.roll(vertex, -1, axis=1)
    corners = [vertex[:-1], turned[:-1], turned[1:], vertex[1:]]
    used, quads = np.unique(np.stack(corners, axis=-1), return_inverse=True)
    faces = [list(dict.fromkeys(quad)) for quad in quads.reshape(-1, 4).tolist()]
    return points.reshape(-1, 3)[used], [face for face in faces if len(face) > 2]


_SURFACES = {
    "box": _box,
    "sphere": lambda form: _ellipsoid(form["center"], [form["radius"]] * 3),
    "ellipsoid": lambda form: _ellipsoid(form["center"], form["radii"]),
    "cylinder": lambda form: _cone(form["endpoints"], [form["radius"]] * 2),
    "capsule": lambda form: _capsule(form["endpoints"], form["radius"]),
    "cone": lambda form: _cone(form["endpoints"], form["radii"]),
    "torus": _torus,
}
