"""Conversion of the domain: the region of their box between the walls of a configuration.

Their walls are conditions at nodes, ours coincide with node planes at the ends of the domain. So
the domain ends at the outermost nodes that their walls still leave in motion along the wall.
"""

import math
from typing import NamedTuple

import numpy as np

from . import source_schema
from .body_pose import BodyPose
from .config_reader import Config, KeyPath, Report

SIDES = (("west", "east"), ("south", "north"), ("bottom", "top"))
PADDING = {False: (2, 3), True: (5, 5)}  # [nodes] below and above, of PhysGaussian and VersaGauss
RESET = "theirs holds everything before its time and for 15 steps after; here nothing does"
NODE_TOLERANCE = 1e-6  # [cells] their nodes are computed in single precision


class WallPlane(NamedTuple):
    """Wall at a node of an axis, which constrains all matter above (side 0) or below (1) it."""

    axis: int
    side: int
    node: int
    kind: str
    key_path: KeyPath
    value: object


class ConvertedDomain(NamedTuple):
    """Domain in their box.

    low, high: first and last nodes, shape (3,); kinds: kinds of its six walls; used: conditions
    that have become walls.
    """

    low: np.ndarray
    high: np.ndarray
    kinds: dict[str, str]
    used: set[int]

    def size(self, cell: float) -> np.ndarray:
        """Return the size [m]."""
        return (self.high - self.low) * cell


def convert_domain(config: Config, poses: list[BodyPose], report: Report) -> ConvertedDomain:
    """Return the domain, with the innermost wall on each side that leaves all bodies inside."""
    count = config.run.n_grid
    low, high = np.zeros(3, dtype=int), np.full(3, count)
    kinds = {name: "open" for pair in SIDES for name in pair}
    planes, used = _planes(config, poses, report)
    for plane in planes:
        name = SIDES[plane.axis][plane.side]
        current = (low, high)[plane.side][plane.axis]
        is_inner = plane.node > current if plane.side == 0 else plane.node < current
        if is_inner and (reason := _reason_against(config, plane, poses)):
            report.dropped(plane.key_path, plane.value, f"{name}: {reason}")
            continue
        if is_inner:
            (low, high)[plane.side][plane.axis] = plane.node
        if is_inner or (plane.node == current and kinds[name] != "stick"):
            kinds[name] = plane.kind
    for axis in range(3):
        if high[axis] - low[axis] < 4:  # too thin for a simulation
            low[axis], high[axis] = 0, count
            for name in SIDES[axis]:
                kinds[name] = "open"
            message = f"the walls leave less than 4 cells along {'xyz'[axis]}: none stands there"
            report.note(f"boundary_conditions: {message}")
    return ConvertedDomain(low, high, kinds, used)


def _reason_against(config: Config, plane: WallPlane, poses: list[BodyPose]) -> str:
    """Return why a wall cannot be at a plane, or "". Bodies without a file are cut to fit."""
    wall = plane.node * config.cell
    for k, pose in enumerate(poses):
        if pose.x is None or not _moves(config, k):
            continue
        if plane.kind == "stick" and pose.straight:  # the part behind it is static, and only drawn
            continue
        distance = wall - pose.low[plane.axis] if plane.side == 0 else pose.high[plane.axis] - wall
        if distance > 0:
            return f"'{pose.name}' reaches {distance:.3g} beyond it, where nothing can be here"
    return ""


def _moves(config: Config, k: int) -> bool:
    """Return whether walls act on a body: it is neither static nor only a template of an inlet."""
    emitter = getattr(config.run, "add_particle", None)
    is_template = emitter is not None and emitter.additional and emitter.object_material_index == k
    return not (is_template or getattr(config.bodies[k].law, "static", False))


def _planes(
    config: Config, poses: list[BodyPose], report: Report
) -> tuple[list[WallPlane], set[int]]:
    """Return all conditions that are walls, and their numbers."""
    planes: list[WallPlane] = []
    used: set[int] = set()
    for k, condition in config.conditions:
        key_path: KeyPath = ("boundary_conditions", k)
        if isinstance(condition, source_schema.BoundingBox):
            below, above = PADDING[config.is_versagauss]
            ends = (below, config.run.n_grid - above)
            planes += [
                WallPlane(axis, side, ends[side], "separate", key_path, "bounding_box")
                for axis in range(3) for side in (0, 1)
            ]  # fmt: skip
        elif isinstance(condition, source_schema.Plane):
            planes += _planes_of_bounds(config, condition, key_path)
        elif isinstance(condition, source_schema.SurfaceCollider):
            planes += _plane_of_surface(config, condition, key_path, report)
        elif isinstance(condition, source_schema.Cuboid):
            plane = _plane_of_cuboid(config, condition, key_path, poses)
            if plane is None:
                continue
            planes.append(plane)
            if condition.reset == 1:
                report.dropped((*key_path, "reset"), condition.reset, RESET)
            reason = "a wall across the domain, which holds what is in the box as it is"
            report.approximated(key_path, plane.value, reason)
        else:
            continue
        used.add(k)
    return planes, used


def _planes_of_bounds(
    config: Config, condition: source_schema.Plane, key_path: KeyPath
) -> list[WallPlane]:
    """Return the walls of a condition that stops outward motion at nodes on a plane and beyond."""
    planes = []
    for axis, name in enumerate(("x_plane", "y_plane", "z_plane")):
        low, high = (edge / config.cell for edge in getattr(condition, name))
        nodes = math.floor(low + NODE_TOLERANCE), math.ceil(high - NODE_TOLERANCE)
        value = list(getattr(condition, name))
        planes += [
            WallPlane(axis, s, nodes[s], "separate", (*key_path, name), value) for s in (0, 1)
        ]
    return [p for p in planes if 0 <= p.node <= config.run.n_grid]


def _plane_of_surface(
    config: Config, condition: source_schema.SurfaceCollider, key_path: KeyPath, report: Report
) -> list[WallPlane]:
    """Return the wall of a condition that stops all nodes behind a surface."""
    normal = np.asarray(condition.normal)
    axis = int(np.argmax(np.abs(normal)))
    value = {"type": condition.type, "surface": condition.surface}
    if not np.any(normal):
        report.dropped((*key_path, "normal"), list(condition.normal), "it has no direction")
        return []
    if np.count_nonzero(normal) > 1:
        reason = (
            "walls stand across an axis: a slope is scenery with collider = true here, and slides"
        )
        report.dropped(key_path, value, reason)
        return []
    if condition.start_time > 0 or condition.end_time < config.end:
        reason = (
            "it is there for a part of the time only; a wall holds from the start to the end here"
        )
        report.dropped(key_path, value, reason)
        return []
    if condition.surface == "cut":
        report.dropped(key_path, value, "it acts at heights that stand in PhysGaussian's code")
        return []
    if condition.surface != "sticky":
        reason = "their program holds all surfaces but 'cut' fast in the end: the wall sticks"
        report.approximated((*key_path, "surface"), condition.surface, reason)
    if condition.friction:
        reason = "what sticks does not rub; theirs sets the velocity to 0 after its friction, too"
        report.dropped((*key_path, "friction"), condition.friction, reason)
    edge = condition.point[axis] / config.cell
    if normal[axis] > 0:
        return [WallPlane(axis, 0, math.ceil(edge - NODE_TOLERANCE) - 1, "stick", key_path, value)]
    return [WallPlane(axis, 1, math.floor(edge + NODE_TOLERANCE) + 1, "stick", key_path, value)]


def _plane_of_cuboid(
    config: Config, condition: source_schema.Cuboid, key_path: KeyPath, poses: list[BodyPose]
) -> WallPlane | None:
    """Return the wall of a box that is at rest for all the time, behind which no body lies.

    Matter inside stays, and the rest is supported by it as by a wall. The box spans their whole
    box, or a body in it.
    """
    if any(condition.velocity) or condition.start_time > 0 or condition.end_time < config.end:
        return None
    low, high = (
        np.subtract(condition.point, condition.size),
        np.add(condition.point, condition.size),
    )
    cell, box_size = config.cell, config.run.grid_lim
    bodies = [s for k, s in enumerate(poses) if _moves(config, k)]
    value = {"type": condition.type, "point": list(condition.point), "size": list(condition.size)}
    for axis in range(3):
        other_axes = [a for a in range(3) if a != axis]
        spans_box = all(
            low[a] <= cell * (1 + NODE_TOLERANCE)
            and high[a] >= box_size - cell * (1 + NODE_TOLERANCE)
            for a in other_axes
        )
        top = math.ceil(high[axis] / cell - NODE_TOLERANCE) - 1
        bottom = math.floor(low[axis] / cell + NODE_TOLERANCE) + 1
        if top < bottom:  # between two nodes
            continue
        for side, node, opposite_node in ((0, top, bottom), (1, bottom, top)):
            sign = 1 - 2 * side
            near_edges = [sign * (s.low, s.high)[side][axis] for s in bodies]
            far_edges = [sign * (s.high, s.low)[side][axis] for s in bodies]
            if (
                not bodies
                or min(near_edges) < sign * opposite_node * cell
                or min(far_edges) <= sign * node * cell
            ):
                continue
            touching = [
                s for s, edge in zip(bodies, near_edges, strict=True) if edge < sign * node * cell
            ]
            is_covered = all(
                (low[a] <= s.low[a] and s.high[a] <= high[a]) for s in touching for a in other_axes
            )
            if is_covered and (spans_box or touching):
                return WallPlane(axis, side, node, "stick", key_path, value)
    return None
