"""Conversion of conditions that hold a part of an elastic body from the start to the end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from . import source_schema
from .body_pose import BodyPose
from .config_reader import Config, Report

Table = dict[str, Any]
POINTS = 40  # points along each edge of a body without Gaussians


class HeldRegion(NamedTuple):
    """Region in their box whose particles a condition moves."""

    within: Callable[[np.ndarray], np.ndarray]  # which points (n, 3) are in it
    shape: str  # key of a scene's shape
    corners: tuple  # its two points [m], of a box or of an axis
    radius: float  # [m] of a cylinder
    motion: Table  # of the part, empty if it is at rest
    start: float  # [s]
    end: float  # [s]


class PinnedConditions:
    """Pinned parts of the bodies of a configuration.

    Attributes:
        tables: Parts of each body as in a scene, by number of the body.
    """

    def __init__(self, config: Config, poses: list[BodyPose], families: list[str], origin):
        """Begin without parts.

        Args:
            config: Configuration of the other program.
            poses: Poses of the bodies.
            families: Families of the bodies' materials, "" for static bodies.
            origin: Lower corner of the domain in their box, shape (3,) [m].
        """
        self.config, self.poses, self.families, self.origin = config, poses, families, origin
        self.tables: dict[int, list[Table]] = {}
        self.regions: dict[int, list[HeldRegion]] = {}

    def add(self, k: int, region: HeldRegion) -> bool:
        """Return whether a condition becomes a pinned part of a body, and add it.

        A pinned part is held from the start to the end. Parts of one body do not share Gaussians.

        Args:
            k: Number of the body.
            region: Its region.
        """
        pose, regions = self.poses[k], self.regions.setdefault(k, [])
        law = self.config.bodies[k].law
        if self.families[k] != "solid" or getattr(law, "additional_material_params", None):
            return False
        if region.start > 0 or region.end < self.config.end:
            return False

        x = _points(pose)
        own, count = region.within(x), np.sum([other.within(x) for other in regions], axis=0)
        if not own.any() or (count + own > 1).any() or (count + own > 0).all():
            return False
        points = [(np.asarray(point) - self.origin).tolist() for point in region.corners]
        shape: Any = points
        if region.shape == "cylinder":
            shape = {"endpoints": points, "radius": region.radius}
        motion = dict(region.motion)
        if "pivot" in motion:
            motion["pivot"] = (np.asarray(motion["pivot"]) - self.origin).tolist()
        regions.append(region)
        part = {region.shape: shape} | ({"motion": motion} if motion else {})
        self.tables.setdefault(k, []).append(part)
        return True

    def merge_into(self, object_keys: dict[int, Table], report: Report) -> None:
        """Add the parts to the keys of their bodies.

        Args:
            object_keys: Additional keys of objects, by number of the body (in/out).
            report: Notes on the conversion (in/out).
        """
        for k, parts in self.tables.items():
            if k in object_keys:
                report.note(f"'{self.poses[k].name}' moves as a whole: its held parts are left out")
            else:
                object_keys[k] = {"pinned": parts[0] if len(parts) == 1 else parts}


def _points(pose: BodyPose) -> np.ndarray:
    """Return the Gaussians of a body, or points all over its box, shape (n, 3) [m]."""
    if pose.x is not None:
        return pose.x
    steps = (np.arange(POINTS) + 0.5) / POINTS
    lattice = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return pose.low + lattice * (pose.high - pose.low)


def held_region(condition, within, velocity, spin: float, axis) -> HeldRegion:
    """Return the region of a condition with its motion.

    Args:
        condition: Translation, rotation or box with prescribed velocity.
        within: Function that tells which points (n, 3) are in the region.
        velocity: Velocity, shape (3,) [m/s].
        spin: Angular velocity [rad/s] about the axis.
        axis: Unit vector, shape (3,).
    """
    motion: Table = {"velocity": list(velocity)} if any(velocity) else {}
    if spin:
        pivot = list(condition.point)
        motion |= {"angular_velocity": spin, "axis": list(axis), "pivot": pivot}
    point, radius, shape = np.asarray(condition.point), 0.0, "box"
    if isinstance(condition, source_schema.Turning):
        half, radius = condition.half_height_and_radius
        shape, reach = "cylinder", half * np.asarray(axis)
    else:
        reach = np.asarray(condition.size)
    return HeldRegion(
        within, shape, (point - reach, point + reach), radius, motion, condition.start_time,
        condition.end_time,
    )  # fmt: skip


def in_cylinder(condition: source_schema.Turning, axis: np.ndarray):
    """Return a function that tells which points are in the cylinder of a condition."""
    half, radius = condition.half_height_and_radius

    def within(x: np.ndarray) -> np.ndarray:
        """Return which points (n, 3) are in the cylinder."""
        offset = x - np.asarray(condition.point)
        along = offset @ axis
        return (np.abs(along) < half) & (
            np.linalg.norm(offset - along[:, None] * axis, axis=1) < radius
        )

    return within
