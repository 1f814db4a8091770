"""Surface meshes of colliders that a run's scene describes as a box or a sphere."""

from typing import NamedTuple

import numpy as np

SEGMENTS = 32  # faces around a sphere


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
        shape = shapes.get(name, {})
        if shape.get("box") is not None:
            points, faces = _box(*np.array(shape["box"], dtype=np.float64))
        elif shape.get("sphere") is not None:
            sphere = shape["sphere"]
            points, faces = _sphere(np.array(sphere["center"]), float(sphere["radius"]))
        else:
            names.append(name)
            continue
        matrix = np.array(entry["transform"], dtype=np.float64)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
        color = [float(value) for value in entry.get("color") or (0.7, 0.7, 0.7)]
        number = pose if entry.get("is_moving") else -1
        meshes.append(ColliderMesh(name, points, faces, color, number))
    return meshes, names


def _box(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a box with two corners (3,)."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return low + corners * (high - low), faces


def _sphere(center: np.ndarray, radius: float) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and faces of a sphere."""
    rings = SEGMENTS // 2
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    height = np.repeat(np.cos(theta), SEGMENTS)
    circles = (
        np.outer(np.sin(theta), np.cos(phi)).ravel(),
        np.outer(np.sin(theta), np.sin(phi)).ravel(),
    )
    points = np.concatenate([[[0, 0, 1.0]], np.column_stack([*circles, height]), [[0, 0, -1.0]]])
    last = len(points) - 1
    faces = []
    for k in range(SEGMENTS):
        n = (k + 1) % SEGMENTS
        faces.append([0, 1 + k, 1 + n])
        faces.append([last, last - SEGMENTS + n, last - SEGMENTS + k])
        for ring in range(rings - 2):
            first = 1 + ring * SEGMENTS
            faces.append([first + k, first + SEGMENTS + k, first + SEGMENTS + n, first + n])
    return center + radius * points, faces
