"""Free rigid bodies as they are at the start: what --plan tells of them."""

from typing import NamedTuple

MIN_THICKNESS_CELLS = 2.0  # [cells] of a body or collider, below which the grid does not resolve it
THICKNESS_TOLERANCE_CELLS = 0.25  # [cells] of a thickness that was measured on a lattice


def is_thin(thickness: float, dx: float) -> bool:
    """Return whether the grid does not resolve a body or collider.

    Args:
        thickness: Its thickness [m], measured on a lattice.
        dx: Cell size [m].
    """
    return thickness < (MIN_THICKNESS_CELLS - THICKNESS_TOLERANCE_CELLS) * dx


class RigidBodySummary(NamedTuple):
    """Free rigid body at the start."""

    name: str
    mass: float  # [kg]
    thickness: float  # [m] twice the largest depth in it
    points: int  # points on its surface
    bytes: int  # [bytes] of the lattice of its distances, on every rank


class Overlap(NamedTuple):
    """Free rigid body that overlaps another one or a collider at the start."""

    name: str
    other: str
    depth: float  # [m]


class RigidBodiesSummary(NamedTuple):
    """Free rigid bodies of a scene at the start."""

    bodies: tuple[RigidBodySummary, ...] = ()
    overlaps: tuple[Overlap, ...] = ()  # deepest first
