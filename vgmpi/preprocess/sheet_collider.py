"""Collider of an open mesh: its faces are walls of half a cell, solid between both sides."""

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from vgmpi.preprocess.meshes.mesh_topology import analyze_mesh, describe_turned_shells, oriented
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.scene.objects import Object
from vgmpi.scene.rigid_motion import Trajectory
from vgmpi.scene.scene_feature import features, hint

log = logging.getLogger("vgmpi")
SHEET_CELLS = 0.5  # [cells] thickness: that as which thinner walls act anyway
# [cells] longest edge of the pieces among which the closest face is sought, and for far points
_PIECE_CELLS, _FAR_PIECE_CELLS = 0.25, 1.0
_FAR_CELLS = 5.0  # [cells] distance from which one of the larger pieces will do
_MAX_PIECES = 1 << 22  # pieces up to which triangles are cut
_CLOSEST_PIECES = 4  # pieces whose triangles are measured
_CHUNK = 1 << 14  # [points] measured together


@dataclass(frozen=True)
class SheetCollider:
    """Collider whose surface is at half a thickness from triangles, on both sides.

    corner: corners of the triangles, shape (m, 3, 3) [m]. thickness: of the wall [m].
    """

    name: str
    corner: np.ndarray
    thickness: float
    course: Trajectory | None = None  # its motion; distances are those at the start
    body: Any = None  # its state at the start if a feature moves it
    detail: Any = None  # what a feature has found of its faces, see `MovingColliders`

    @classmethod
    def from_triangles(cls, name: str, corner: np.ndarray, dx: float) -> "SheetCollider":
        """Return the collider of triangles.

        Args:
            name: Name of the object.
            corner: Corners of the triangles, shape (m, 3, 3) [m].
            dx: Cell size [m].
        """
        edge = corner[:, 1:] - corner[:, :1]
        has_area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1) > 0
        return cls(name, corner[has_area], SHEET_CELLS * dx)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corner (3,) [m] of a box that contains it."""
        x = self.corner.reshape(-1, 3)
        return x.min(axis=0) - self.thickness / 2, x.max(axis=0) + self.thickness / 2

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance (m,) [m] of `points` (m, 3) [m], negative in the wall."""
        parts = np.array_split(points, -(-len(points) // _CHUNK) or 1)
        foot = np.concatenate([self._closest(part) for part in parts])
        return np.linalg.norm(points - foot, axis=1) - self.thickness / 2

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Return outward unit normals (m, 3): directions from the closest point of the sheet."""
        parts = np.array_split(points, -(-len(points) // _CHUNK) or 1)
        away = points - np.concatenate([self._closest(part) for part in parts])
        size = np.linalg.norm(away, axis=1)[:, None]
        return np.where(size > 0, away / np.maximum(size, 1e-300), (0.0, 0.0, 1.0))

    def _closest(self, x: np.ndarray) -> np.ndarray:
        """Return the closest points (m, 3) of the triangles."""
        tree, triangle = self._far_pieces
        away, number = tree.query(x)
        best = closest_points(self.corner[triangle[number]], x)
        close_rows = np.flatnonzero(away < _FAR_CELLS / SHEET_CELLS * self.thickness)
        best[close_rows] = self._closest_of_near(x[close_rows])
        return best

    def _closest_of_near(self, x: np.ndarray) -> np.ndarray:
        """Return the closest points (m, 3) of the triangles to points that are not far."""
        tree, triangle = self._pieces
        count = min(_CLOSEST_PIECES, len(triangle))
        number = triangle[tree.query(x, k=count)[1]].reshape(len(x), count)
        best, square = np.empty_like(x), np.full(len(x), np.inf)
        for column in number.T:
            foot = closest_points(self.corner[column], x)
            away = ((x - foot) ** 2).sum(axis=1)
            nearer = away < square
            best[nearer], square[nearer] = foot[nearer], away[nearer]
        return best

    @cached_property
    def _pieces(self) -> "tuple[scipy.spatial.cKDTree, np.ndarray]":
        """Return `_cut` for points that are not far."""
        return self._cut(_PIECE_CELLS)

    @cached_property
    def _far_pieces(self) -> "tuple[scipy.spatial.cKDTree, np.ndarray]":
        """Return `_cut` for far points."""
        return self._cut(_FAR_PIECE_CELLS)

    def _cut(self, cells: float) -> "tuple[scipy.spatial.cKDTree, np.ndarray]":
        """Return a tree of the centers of small pieces, and the triangle of each, shape (k,).

        Args:
            cells: Longest edge of a piece [cells].
        """
        piece, triangle = self.corner, np.arange(len(self.corner))
        longest = cells / SHEET_CELLS * self.thickness
        while len(piece) < _MAX_PIECES:
            edge = np.linalg.norm(piece - np.roll(piece, -1, axis=1), axis=2)
            k, is_long = edge.argmax(axis=1), edge.max(axis=1) > longest
            if not is_long.any():
                break
            row = np.flatnonzero(is_long)
            start, end = k[row], (k[row] + 1) % 3
            middle = (piece[row, start] + piece[row, end]) / 2
            first, second = piece[row].copy(), piece[row].copy()
            every = np.arange(len(row))
            first[every, end] = second[every, start] = middle
            piece = np.concatenate([piece[~is_long], first, second])
            triangle = np.concatenate([triangle[~is_long], triangle[row], triangle[row]])
        return scipy.spatial.cKDTree(piece.mean(axis=1)), triangle


def closest_points(corner: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the closest point (n, 3) of each triangle (n, 3, 3) to each point (n, 3).

    It is the foot on the plane where that lies in the triangle, else the closest of three edges.
    """
    a, b, c = (corner[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = (normal**2).sum(axis=1)
    height = ((x - a) * normal).sum(axis=1) / length
    foot = x - height[:, None] * normal
    is_inside = np.ones(len(x), dtype=bool)
    best, square = np.empty_like(x), np.full(len(x), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        is_inside &= (np.cross(q - p, foot - p) * normal).sum(axis=1) >= 0
        edge = q - p
        along = ((x - p) * edge).sum(axis=1) / np.maximum((edge**2).sum(axis=1), 1e-300)
        on_edge = p + np.clip(along, 0.0, 1.0)[:, None] * edge
        away = ((x - on_edge) ** 2).sum(axis=1)
        nearer = away < square
        best[nearer], square[nearer] = on_edge[nearer], away[nearer]
    return np.where(is_inside[:, None], foot, best)


def examine_mesh(obj: Object, placed: Mesh) -> tuple[Mesh, bool]:
    """Return a mesh whose shells face outward, and whether it is a collider of thin sheets.

    What is unusual about it is logged, in one line each.
    """
    topology = analyze_mesh(placed)
    turned = describe_turned_shells(topology)
    if turned:
        log.info("'%s': %s", obj.name, turned)
    is_sheet = topology.is_open and any(each.takes_open_mesh(obj) for each in features())
    if topology.is_open:
        meaning = "it counts as filled up to its holes"
        if obj.role == "scenery":
            meaning = "it counts as a solid block up to its holes" + hint("open mesh")
            if is_sheet:
                meaning = "it counts as a wall half a cell thick"
        log.info("'%s': its mesh is %s; %s", obj.name, topology.describe_opening(" m"), meaning)
    return oriented(placed, topology), is_sheet
