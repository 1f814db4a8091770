"""Plan of pinned parts: groups whose particles what holds them carries, outside of the grid."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vgmpi.parallel.exchange_topology import GRADIENTS
from vgmpi.planning.feature_plan import BodyPart, FeaturePlan, ReleasedParticles, ReleaseLayer
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.toml_source import escape_control_characters

# [-] cost of a pinned particle relative to a fluid's, python -m tests.benchmarks bodies --pins
PINNED_COST = 0.1  # at rest
MOVING_PINNED_COST = 1.35  # carried by what moves
MAX_LINES = 8  # parts that have a line of the report each; more have one together
CARRIER = "pinned"  # of the groups of parts, see `GroupPlan.carrier`


class PinnedPartPlan(NamedTuple):
    """Pinned part of a body."""

    object: int  # row of the body
    groups: tuple[int, ...]  # of its particles, one for each of `region.by_material`
    groups_after_release: tuple[int, ...]  # groups of these particles after the release
    phase: int  # of the body
    region: Any  # a `regions.PinnedRegion`


class PinnedPartsPlan(FeaturePlan):
    """Pinned parts of a run."""

    name = "pinned_parts"
    nodal_fields = frozenset(GRADIENTS)
    reads_all_nodes, joins_compilation = True, False

    def __init__(self, parts: tuple[PinnedPartPlan, ...]):
        """Take the plans of all parts."""
        self.pinned = parts
        self.phases = frozenset(part.phase for part in parts)
        self.uncounted_groups = frozenset(
            group for part in parts if part.region.is_free for group in part.groups
        )

    def parts(self) -> list[BodyPart]:
        """Return the parts with their groups, by material."""
        return [
            BodyPart(part.object, own.particles, group)
            for part in self.pinned
            for group, own in zip(part.groups, part.region.by_material, strict=True)
        ]

    def assign_groups(self, ids: np.ndarray, groups: np.ndarray) -> None:
        """Set the groups of the particles that are held at the start.

        Args:
            ids: Particle ids, shape (n,).
            groups: Their groups (in/out), shape (n,).
        """
        for part in self.pinned:
            for group, own in zip(part.groups, part.region.by_material, strict=True):
                run = np.searchsorted(own.runs[:, 0], ids, side="right") - 1
                groups[(run >= 0) & (ids <= own.runs[run, 1])] = group

    def released_particles(self) -> list[ReleasedParticles]:
        """Return the particles of parts that let go at a time, by groups."""
        return [
            ReleasedParticles(
                group, released, part.region.course, (ReleaseLayer(part.region.release_time),)
            )
            for part in self.pinned
            if part.region.release_time < np.inf
            for group, released in zip(part.groups, part.groups_after_release, strict=True)
        ]  # fmt: skip

    def reaction_bodies(self) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """Return the bodies that the world holds, with the center of mass of their first parts."""
        centers: dict[tuple[int, ...], tuple[float, ...]] = {}
        for part in self.pinned:
            if part.region.holder < 0:
                centers.setdefault((part.object,), tuple(part.region.masses.center))
        return list(centers.items())

    def reaction_rows(self, first_row: int) -> list[int]:
        """Return the row of the reactions of each part, -1 for those that free bodies hold.

        Parts that a collider holds add to its row. Those of a body that the world holds own one.

        Args:
            first_row: Row of the first body that the world holds.
        """
        bodies = [k for (k,), _ in self.reaction_bodies()]
        rows = []
        for part in self.pinned:
            if part.region.holder < 0:
                rows.append(first_row + bodies.index(part.object))
            else:
                rows.append(-1 if part.region.is_free else part.region.holder)
        return rows

    def report_lines(self, plan: Plan) -> list[str]:
        """Return the lines of --plan on the parts."""
        regions = [part.region for part in self.pinned]
        lines = [
            f"  pinned      {escape_control_characters(region.name)}: {region.count:,} of"
            f" {plan.count[region.object]:,} particles, {region.masses.mass:.4g} kg, to"
            f" {_holder(region)}"
            for region in regions[:MAX_LINES]
        ]
        if len(regions) > MAX_LINES:
            more = regions[MAX_LINES:]
            count = sum(region.count for region in more)
            lines.append(f"  pinned      {len(more):,} more parts: {count:,} particles")
        return lines

    def start(self, context: Any) -> Any:
        """Return the parts as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import PinnedCoupling  # it compiles

        return PinnedCoupling(self, context)


def plan_pinned_parts(
    groups: tuple[GroupPlan, ...], group_of: tuple[int, ...], regions: Sequence
) -> tuple[PinnedPartsPlan, tuple[GroupPlan, ...]]:
    """Plan the pinned parts and their groups.

    Args:
        groups: Groups as if nothing were pinned.
        group_of: Group of each object and particle source, likewise.
        regions: Pinned parts with their particles.

    Returns:
        Their plan, and the groups with those of the parts behind them.
    """
    plans, all_groups = [], list(groups)
    for region in regions:
        phase = groups[group_of[region.object]].phase
        numbers = tuple(range(len(all_groups), len(all_groups) + len(region.by_material)))
        pairs = [(group.phase, group.material) for group in groups]
        group_after_release = tuple(
            pairs.index((phase, own.material)) for own in region.by_material
        )
        plans.append(PinnedPartPlan(region.object, numbers, group_after_release, phase, region))
        is_moving = region.is_free or region.course is not None
        cost = MOVING_PINNED_COST if is_moving else PINNED_COST
        for free in (groups[number] for number in group_after_release):
            name = f"{region.name} (pinned to {region.to})/{free.material}"
            all_groups.append(free._replace(name=name, carrier=CARRIER, cost=cost))
    return PinnedPartsPlan(tuple(plans)), tuple(all_groups)


def _holder(region: Any) -> str:
    """Return what holds a pinned part."""
    if region.is_free:
        return f"{escape_control_characters(region.to)}, which carries this mass"
    name = "the world" if region.holder < 0 else escape_control_characters(region.to)
    return name if region.course is None else f"{name}, which moves"
