"""Free rigid bodies as they are at the start: what --plan tells of them."""

from typing import NamedTuple


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
