"""The domain: what of their box lies between the walls of a configuration.

Their walls are conditions at nodes, ours stand on node planes at the ends of the domain. So the
domain ends at the outermost nodes that a wall of theirs still leaves in motion along it.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.convert import keys
from vgmpi.convert.reading import Config, Report, Where
from vgmpi.convert.standing import Standing

SIDES = (("west", "east"), ("south", "north"), ("floor", "roof"))
PADDING = {False: (2, 3), True: (5, 5)}  # nodes below and above, of PhysGaussian and VersaGauss
RESET = "theirs holds everything before its time and for 15 steps after; here nothing does"
NEAR = 1e-6  # cells: nodes are computed in single precision there


class Plane(NamedTuple):
    """A wall: it stands at a node of an axis and holds what is above (side 0) or below (1) it."""

    axis: int
    side: int
    node: int
    kind: str
    at: Where
    value: object


class Room(NamedTuple):
    """The domain in their box: its first and last nodes (3,), the kinds of its six walls, and
    which conditions have become walls."""

    low: np.ndarray
    high: np.ndarray
    kinds: dict[str, str]
    used: set[int]

    def size(self, cell: float) -> np.ndarray:
        return (self.high - self.low) * cell


def room(config: Config, standings: list[Standing], report: Report) -> Room:
    """The domain, with the innermost wall on each side that leaves all bodies in it."""
    count = config.run.n_grid
    low, high = np.zeros(3, dtype=int), np.full(3, count)
    kinds = {name: "open" for pair in SIDES for name in pair}
    planes, used = _planes(config, standings, report)
    for plane in planes:
        name = SIDES[plane.axis][plane.side]
        now = (low, high)[plane.side][plane.axis]
        inner = plane.node > now if plane.side == 0 else plane.node < now
        if inner and (beyond := _beyond(config, plane, standings)):
            report.lost(plane.at, plane.value, f"{name}: {beyond}")
            continue
        if inner:
            (low, high)[plane.side][plane.axis] = plane.node
        if inner or (plane.node == now and kinds[name] != "stick"):
            kinds[name] = plane.kind
    for axis in range(3):
        if high[axis] - low[axis] < 4:  # nothing could be computed in it
            low[axis], high[axis] = 0, count
            for name in SIDES[axis]:
                kinds[name] = "open"
            said = f"the walls leave less than 4 cells along {'xyz'[axis]}: none stands there"
            report.note(f"boundary_conditions: {said}")
    return Room(low, high, kinds, used)


def _beyond(config: Config, plane: Plane, standings: list[Standing]) -> str:
    """Why a wall cannot stand there, or nothing. What has no file yet is cut to fit."""
    wall = plane.node * config.cell
    for k, one in enumerate(standings):
        if one.x is None or not _moves(config, k):
            continue
        if plane.kind == "stick" and one.straight:  # what stays behind it is held, and only drawn
            continue
        out = wall - one.low[plane.axis] if plane.side == 0 else one.high[plane.axis] - wall
        if out > 0:
            return f"'{one.name}' reaches {out:.3g} beyond it, where nothing can be here"
    return ""


def _moves(config: Config, k: int) -> bool:
    """Whether a body is one that walls hold: neither held itself nor but the mould of a source."""
    more = getattr(config.run, "add_particle", None)
    mould = more is not None and more.additional and more.object_material_index == k
    return not (mould or getattr(config.bodies[k].law, "static", False))


def _planes(
    config: Config, standings: list[Standing], report: Report
) -> tuple[list[Plane], set[int]]:
    """All conditions that are walls."""
    found: list[Plane] = []
    used: set[int] = set()
    for k, one in config.conditions:
        at: Where = ("boundary_conditions", k)
        if isinstance(one, keys.BoundingBox):
            below, above = PADDING[config.several]
            ends = (below, config.run.n_grid - above)
            found += [
                Plane(axis, side, ends[side], "separate", at, "bounding_box")
                for axis in range(3) for side in (0, 1)
            ]  # fmt: skip
        elif isinstance(one, keys.Plane):
            found += _between(config, one, at)
        elif isinstance(one, keys.SurfaceCollider):
            found += _surface(config, one, at, report)
        elif isinstance(one, keys.Cuboid):
            plane = _slab(config, one, at, standings)
            if plane is None:
                continue
            found.append(plane)
            if one.reset == 1:
                report.lost((*at, "reset"), one.reset, RESET)
            why = "a wall across the domain, which holds what is in the box as it is"
            report.partly(at, plane.value, why)
        else:
            continue
        used.add(k)
    return found, used


def _between(config: Config, one: keys.Plane, at: Where) -> list[Plane]:
    """Nodes on a plane and beyond do not move outward."""
    found = []
    for axis, name in enumerate(("x_plane", "y_plane", "z_plane")):
        low, high = (edge / config.cell for edge in getattr(one, name))
        nodes = math.floor(low + NEAR), math.ceil(high - NEAR)
        value = list(getattr(one, name))
        found += [Plane(axis, s, nodes[s], "separate", (*at, name), value) for s in (0, 1)]
    return [p for p in found if 0 <= p.node <= config.run.n_grid]


def _surface(config: Config, one: keys.SurfaceCollider, at: Where, report: Report) -> list[Plane]:
    """Nodes behind a surface stand still."""
    normal = np.asarray(one.normal)
    axis = int(np.argmax(np.abs(normal)))
    value = {"type": one.type, "surface": one.surface}
    if not np.any(normal):
        report.lost((*at, "normal"), list(one.normal), "it has no direction")
        return []
    if np.count_nonzero(normal) > 1:
        why = "walls stand across an axis: a slope is scenery with collider = true here, and slides"
        report.lost(at, value, why)
        return []
    if one.start_time > 0 or one.end_time < config.end:
        why = "it is there for a part of the time only; a wall holds from the start to the end here"
        report.lost(at, value, why)
        return []
    if one.surface == "cut":
        report.lost(at, value, "it acts at heights that stand in PhysGaussian's code")
        return []
    if one.surface != "sticky":
        why = "their program holds all surfaces but 'cut' fast in the end: the wall sticks"
        report.partly((*at, "surface"), one.surface, why)
    if one.friction:
        why = "what sticks does not rub; theirs sets the velocity to 0 after its friction, too"
        report.lost((*at, "friction"), one.friction, why)
    edge = one.point[axis] / config.cell
    if normal[axis] > 0:
        return [Plane(axis, 0, math.ceil(edge - NEAR) - 1, "stick", at, value)]
    return [Plane(axis, 1, math.floor(edge + NEAR) + 1, "stick", at, value)]


def _slab(config: Config, one: keys.Cuboid, at: Where, standings: list[Standing]) -> Plane | None:
    """A box that is held still for all the time, behind which no body lies: what is in it stays,
    and the rest stands on it as on a wall. It goes across all of their box, or of a body in it."""
    if any(one.velocity) or one.start_time > 0 or one.end_time < config.end:
        return None
    low, high = np.subtract(one.point, one.size), np.add(one.point, one.size)
    cell, most = config.cell, config.run.grid_lim
    bodies = [s for k, s in enumerate(standings) if _moves(config, k)]
    value = {"type": one.type, "point": list(one.point), "size": list(one.size)}
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        across = all(low[a] <= cell * (1 + NEAR) and high[a] >= most - cell * (1 + NEAR)
                     for a in others)  # fmt: skip
        top = math.ceil(high[axis] / cell - NEAR) - 1
        bottom = math.floor(low[axis] / cell + NEAR) + 1
        if top < bottom:  # between two nodes
            continue
        for side, node, far in ((0, top, bottom), (1, bottom, top)):
            sign = 1 - 2 * side
            near = [sign * (s.low, s.high)[side][axis] for s in bodies]
            past = [sign * (s.high, s.low)[side][axis] for s in bodies]
            if not bodies or min(near) < sign * far * cell or min(past) <= sign * node * cell:
                continue
            meets = [s for s, edge in zip(bodies, near, strict=True) if edge < sign * node * cell]
            held = all((low[a] <= s.low[a] and s.high[a] <= high[a]) for s in meets for a in others)
            if held and (across or meets):
                return Plane(axis, side, node, "stick", at, value)
    return None
