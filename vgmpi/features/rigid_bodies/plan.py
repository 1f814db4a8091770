"""Plan of free rigid bodies: the bodies at the start, their joints, and lines of reports."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from vgmpi.parallel.exchange_topology import NEAR_BODIES
from vgmpi.planning.feature_plan import FeaturePlan
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.motion_checks import MIN_THICKNESS_CELLS, is_thin
from vgmpi.runtime.config.toml_source import escape_control_characters

from .table import Joint

MAX_LINES = 8  # bodies that have a line each; more have one together
MIN_DENSITY_RATIO = 0.01  # [-] to what a body meets, below which none was tested


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

    bodies: tuple[RigidBodySummary, ...]
    overlaps: tuple[Overlap, ...]  # deepest first


class RigidBodiesPlan(FeaturePlan):
    """Free rigid bodies of a run."""

    name, joins_compilation = "rigid_bodies", False
    nodal_fields = frozenset(NEAR_BODIES)
    reads_at_colliders = numbers_colliders = has_momentum = True
    step_limit = "shorter where rigid bodies or spray are fast"
    collider_title = "free rigid bodies"

    def __init__(
        self, density: Mapping[str, float], joints: tuple[Joint, ...],
        at_start: RigidBodiesSummary | None,
    ):  # fmt: skip
        """Take the bodies.

        Args:
            density: Density of each body by name [kg/m3].
            joints: Joints of the scene.
            at_start: The bodies at the start, None if unknown.
        """
        self.density, self.joints, self.at_start = density, joints, at_start
        self.moved_colliders = len(density)
        self.counted = len(density), "body", "rigid bodies"

    def contributes(self, phase: int) -> bool:
        """Return whether a phase contributes to the fields: all may meet a body."""
        return True

    def report_lines(self, plan: Plan) -> list[str]:
        """Return the lines of the plan report on the bodies and their joints."""
        joints = [f"{joint.kind} of {' and '.join(joint.between)}" for joint in self.joints]
        text = ", ".join(map(escape_control_characters, joints))
        return self._body_lines(plan) + ([f"  joints      {text}"] if joints else [])

    def _body_lines(self, plan: Plan) -> list[str]:
        """Return the lines on the bodies."""
        if self.at_start is None:
            return [f"  rigid       {_listing(list(self.density))}: free bodies without particles"]
        bodies = self.at_start.bodies
        liquids = {group.material: group.density for group in plan.groups if group.is_liquid}
        if len(bodies) > MAX_LINES:
            return [_summary_line(bodies, plan.dx)]
        return [_body_line(body, self.density[body.name], liquids, plan.dx) for body in bodies]

    def warning_lines(self, plan: Plan) -> list[str]:
        """Return a line on bodies that are thin, light, or overlap something at the start."""
        if self.at_start is None:
            return []
        lines = []
        thin = [body.name for body in self.at_start.bodies if is_thin(body.thickness, plan.dx)]
        if thin:
            lines.append(
                f"{_listing(thin)}: rigid and thinner than {MIN_THICKNESS_CELLS:g} cells:"
                " what flows may pass through"
            )
        heaviest = max(group.density for group in plan.groups)
        light = [
            name for name, value in self.density.items() if value < MIN_DENSITY_RATIO * heaviest
        ]
        if light:
            lines.append(
                f"{_listing(light)}: rigid and lighter than {MIN_DENSITY_RATIO:g} of the"
                f" heaviest that it may meet, {heaviest:g} kg/m3: not tested"
            )
        joined = {frozenset(joint.between) for joint in self.joints if joint.kind != "spring"}
        overlaps = [o for o in self.at_start.overlaps if frozenset((o.name, o.other)) not in joined]
        for pair in overlaps[:MAX_LINES]:
            names = map(escape_control_characters, (pair.name, pair.other))
            lines.append(
                f"{' and '.join(names)} overlap at the start by"
                f" {pair.depth / plan.dx:.2g} cells ({pair.depth:.3g} m):"
                " they are pushed apart slowly"
            )
        if len(overlaps) > MAX_LINES:
            lines.append(f"{len(overlaps) - MAX_LINES} more pairs overlap less")
        return lines

    def moved_bodies(self, colliders: list) -> Any:
        """Return the state of the bodies at the start.

        Args:
            colliders: All colliders at the start.
        """
        from .free_bodies import FreeBodies  # it compiles

        return FreeBodies(colliders)

    def start(self, context: Any) -> Any:
        """Return the bodies as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import RigidBodies  # it compiles

        return RigidBodies(self, context)


def _listing(names: list[str]) -> str:
    """Return names with commas between them; the first ones of many."""
    more = f" and {len(names) - MAX_LINES} more" if len(names) > MAX_LINES else ""
    return ", ".join(map(escape_control_characters, names[:MAX_LINES])) + more


def _body_line(body: RigidBodySummary, density: float, liquids: dict[str, float], dx: float) -> str:
    """Return the line on one body.

    Args:
        body: The body.
        density: Its density [kg/m3].
        liquids: Density of each liquid of the scene [kg/m3].
        dx: Cell size [m].
    """
    ratios = "".join(
        f", {density / other:.3g} times the density of {escape_control_characters(name)}"
        for name, other in liquids.items()
    )
    return (
        f"  rigid       {escape_control_characters(body.name)}: {body.mass:.4g} kg{ratios},"
        f" {body.thickness / dx:.1f} cells thick, {body.points:,} surface points,"
        f" {body.bytes / 2**20:.2g} MiB of distances per rank"
    )


def _summary_line(bodies: tuple[RigidBodySummary, ...], dx: float) -> str:
    """Return the line on many bodies."""
    masses, cells = (sorted(values) for values in (
        [body.mass for body in bodies], [body.thickness / dx for body in bodies]
    ))  # fmt: skip
    return (
        f"  rigid       {len(bodies):,} bodies of {masses[0]:.4g} to {masses[-1]:.4g} kg,"
        f" {cells[0]:.1f} to {cells[-1]:.1f} cells thick,"
        f" {sum(body.points for body in bodies):,} surface points,"
        f" {sum(body.bytes for body in bodies) / 2**20:.2g} MiB of distances per rank"
    )
