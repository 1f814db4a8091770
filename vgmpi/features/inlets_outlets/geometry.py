"""Lattice of particles of an inlet.

Columns of particles stand at (i + 1/2) h, (j + 1/2) h in the frame of the mouth, inside its
opening. The particles of a column are h apart along the direction, so that every particle has the
rest volume h^3. No two columns are at the same height: a layer of one particle per column is
spread evenly over h along the flow (`inlet_points`).
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Protocol

import numpy as np

from vgmpi.runtime.config.schema import Point, Positive, StrictModel

NOZZLE_CELLS = 2  # [cells] length of the nozzle behind the mouth
VERTICAL = 1e-12  # [-] largest horizontal part of a vertical direction
RELATIVE_RIM_MARGIN = 1e-9  # [-] of the size: margin that puts points on the rim outside
TOUCH_TOLERANCE_CELLS = 1e-6  # [cells] by which rounding may move a nozzle beyond what it touches
PLASTIC_NUMBER = 1.32471795724474602596  # [-] the real solution of p^3 = p + 1


class Disc(StrictModel):
    """Round mouth."""

    center: Point
    """its center"""
    radius: Positive
    """its radius"""


class Rectangle(StrictModel):
    """Rectangular mouth."""

    center: Point
    """its center"""
    width: Positive
    """its extent perpendicular to the flow, horizontally"""
    height: Positive
    """its extent perpendicular to both"""


class Opening(Protocol):
    """Attributes of an inlet that determine its lattice."""

    disc: Disc | None
    rectangle: Rectangle | None
    direction: tuple[float, float, float]
    particles_per_cell: int

    @property
    def opening(self) -> Disc | Rectangle:
        """Return the shape of its mouth."""


def spacing(source: Opening, dx: float) -> float:
    """Return the lattice spacing h [m]."""
    return dx / _per_edge(source)


def layers_in_nozzle(source: Opening) -> int:
    """Return the number of layers in the nozzle."""
    return NOZZLE_CELLS * _per_edge(source)


def _per_edge(source: Opening) -> int:
    """Return the number of lattice points per cell edge."""
    return round(source.particles_per_cell ** (1 / 3))


def orthonormal_frame(source: Opening) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors (3,): a horizontal and a second one across the direction, and it."""
    x, y, z = source.direction
    horizontal = math.hypot(x, y)
    u = np.array([1.0, 0.0, 0.0])
    if horizontal > VERTICAL:
        u = np.array([-y / horizontal, x / horizontal, 0.0])
    along = np.array([x, y, z])
    return u, np.cross(along, u), along


def extent(source: Opening) -> tuple[float, float]:
    """Return half of the opening's extent [m] along both vectors across."""
    if source.disc is not None:
        return source.disc.radius, source.disc.radius
    assert source.rectangle is not None
    return source.rectangle.width / 2, source.rectangle.height / 2


def too_small(source: Opening, dx: float) -> bool:
    """Return whether no lattice point lies in the opening."""
    half, (a, b) = spacing(source, dx) / 2, extent(source)
    if source.disc is not None:
        return bool(math.hypot(half, half) >= a * (1 - RELATIVE_RIM_MARGIN))
    return bool(half >= min(a, b) * (1 - RELATIVE_RIM_MARGIN))


def per_layer(source: Opening, dx: float) -> float:
    """Return the approximate number of particles per layer."""
    a, b = extent(source)
    return (math.pi if source.disc is not None else 4.0) * a * b / spacing(source, dx) ** 2


def inlet_points(source: Opening, dx: float) -> np.ndarray:
    """Return the points (n, 3) [m] of a layer at the mouth, in the order in which they pass it.

    The order is that of the fractional part of i / p + j / p^2 with the plastic number p. 1, 1/p
    and 1/p^2 are badly approximable, so no stretch of the stream along the flow, with the
    contraction across that belongs to it, brings the particles into planes or close together.

    Args:
        source: The inlet.
        dx: Cell size [m].
    """
    h, (a, b), (e_u, e_v, _) = spacing(source, dx), extent(source), orthonormal_frame(source)
    i, j = (part.ravel() for part in np.meshgrid(_columns(a, h), _columns(b, h), indexing="ij"))
    u, v = (i + 0.5) * h, (j + 0.5) * h
    if source.disc is not None:
        inside = u * u + v * v < (a * (1 - RELATIVE_RIM_MARGIN)) ** 2
        i, j, u, v = i[inside], j[inside], u[inside], v[inside]
    order = np.argsort((i / PLASTIC_NUMBER + j / PLASTIC_NUMBER**2) % 1.0, kind="stable")
    u, v = u[order, None], v[order, None]
    return np.array(source.opening.center) + u * e_u + v * e_v


def _columns(half: float, h: float) -> np.ndarray:
    """Return the integers i of the points (i + 1/2) h within `half` [m] of the center."""
    count = math.ceil(half * (1 - RELATIVE_RIM_MARGIN) / h - 0.5)
    return np.arange(-count, count)


def bounding_box(source: Opening, dx: float) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner (3,) [m] of a box that contains opening and nozzle."""
    (a, b), (e_u, e_v, along) = extent(source), orthonormal_frame(source)
    half = np.abs(e_u) * a + np.abs(e_v) * b
    if source.disc is not None:
        half = a * np.sqrt(np.maximum(1.0 - along**2, 0.0))
    center = np.array(source.opening.center)
    back = center - layers_in_nozzle(source) * spacing(source, dx) * along
    return np.minimum(center, back) - half, np.maximum(center, back) + half


def wall_weights(
    points: np.ndarray, axis: int, cells: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (n, 3) of a wall around points on it, and the sums of their weights.

    A point is shared by the four nodes around it. A node at an edge of the wall has twice as much:
    only a half of what is around it lies inside.

    Args:
        points: The points, shape (m, 3) [cells].
        axis: Axis across the wall.
        cells: Cells of the domain, three numbers.
    """
    low = np.floor(points).astype(int)
    low[:, axis] = np.rint(points[:, axis])
    corners = [step for step in product((0, 1), repeat=3) if step[axis] == 0]
    corner_nodes = np.concatenate([low + corner for corner in corners])
    away = np.abs(np.tile(points, (len(corners), 1)) - corner_nodes)
    weights = np.delete(1.0 - away, axis, axis=1).prod(1)
    nodes, row = np.unique(corner_nodes, axis=0, return_inverse=True)
    is_at_edge = ((nodes == 0) | (nodes == cells)) & (np.arange(3) != axis)
    return nodes, np.bincount(row.reshape(-1), weights) * 2.0 ** is_at_edge.sum(1)
