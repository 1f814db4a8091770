"""The lattice on which particles come out of a source.

Points (i + 1/2) h, (j + 1/2) h of the mouth's own frame that lie in its opening, one layer after
the other every h along its direction: every particle has the rest volume h^3.
"""

import math
from typing import Protocol

import numpy as np

from vgmpi.tables import Point, Positive, Table

LENGTH = 2  # cells behind the mouth
VERTICAL = 1e-12  # horizontal part of a direction that is straight up or down
EDGE = 1e-9  # of a size, by which an opening is narrower: a point on its rim is outside


class Disc(Table):
    """A round mouth."""

    center: Point
    """its middle"""
    radius: Positive
    """its radius"""


class Rectangle(Table):
    """A mouth with corners."""

    center: Point
    """its middle"""
    width: Positive
    """its extent across the direction it pours in, horizontally"""
    height: Positive
    """its extent across both"""


class Opening(Protocol):
    """What is needed of a source to know its lattice."""

    disc: Disc | None
    rectangle: Rectangle | None
    direction: tuple[float, float, float]
    particles_per_cell: int

    @property
    def opening(self) -> Disc | Rectangle:
        """Its mouth."""


def spacing(source: Opening, dx: float) -> float:
    """Distance h of the lattice's points [m]."""
    return dx / _per_edge(source)


def ahead(source: Opening) -> int:
    """Layers in the nozzle."""
    return LENGTH * _per_edge(source)


def _per_edge(source: Opening) -> int:
    return round(source.particles_per_cell ** (1 / 3))


def frame(source: Opening) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (3,): across the direction, first horizontally, and along it."""
    x, y, z = source.direction
    flat = math.hypot(x, y)
    one = np.array([1.0, 0.0, 0.0])
    if flat > VERTICAL:
        one = np.array([-y / flat, x / flat, 0.0])
    along = np.array([x, y, z])
    return one, np.cross(along, one), along


def extent(source: Opening) -> tuple[float, float]:
    """Half of the opening's extent along both vectors across [m]."""
    if source.disc is not None:
        return source.disc.radius, source.disc.radius
    assert source.rectangle is not None
    return source.rectangle.width / 2, source.rectangle.height / 2


def too_small(source: Opening, dx: float) -> bool:
    """Whether no point of the lattice lies in the opening."""
    half, (a, b) = spacing(source, dx) / 2, extent(source)
    if source.disc is not None:
        return bool(math.hypot(half, half) >= a * (1 - EDGE))
    return bool(half >= min(a, b) * (1 - EDGE))


def per_layer(source: Opening, dx: float) -> float:
    """How many particles a layer has, about."""
    a, b = extent(source)
    return (math.pi if source.disc is not None else 4.0) * a * b / spacing(source, dx) ** 2


def mouth(source: Opening, dx: float) -> np.ndarray:
    """The points (n, 3) [m] of a layer that is at the mouth, row by row."""
    h, (a, b), (one, other, _) = spacing(source, dx), extent(source), frame(source)
    i, j = (_centered(size, h) for size in (a, b))
    u, v = (part.ravel() for part in np.meshgrid(i, j, indexing="ij"))
    if source.disc is not None:
        inside = u * u + v * v < (a * (1 - EDGE)) ** 2
        u, v = u[inside], v[inside]
    return np.array(source.opening.center) + u[:, None] * one + v[:, None] * other


def _centered(half: float, h: float) -> np.ndarray:
    """(i + 1/2) h within half to both sides [m]."""
    count = math.ceil(half * (1 - EDGE) / h - 0.5)
    return (np.arange(-count, count) + 0.5) * h


def box(source: Opening, dx: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of a box that holds opening and nozzle."""
    (a, b), (one, other, along) = extent(source), frame(source)
    reach = np.abs(one) * a + np.abs(other) * b
    if source.disc is not None:
        reach = a * np.sqrt(np.maximum(1.0 - along**2, 0.0))
    center = np.array(source.opening.center)
    back = center - ahead(source) * spacing(source, dx) * along
    return np.minimum(center, back) - reach, np.maximum(center, back) + reach
