"""Groups of the particles of pinned parts: carried by what holds them, outside of the grid."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .phases_and_groups import GroupPlan

# [-] cost of a pinned particle relative to a fluid's, python -m tests.benchmarks bodies --pins
PINNED_COST = 0.1  # at rest
MOVING_PINNED_COST = 1.35  # carried by what moves


class PinnedPlan(NamedTuple):
    """Pinned part of a body."""

    object: int  # row of the body
    groups: tuple[int, ...]  # of its particles, one for each of `region.shares`
    joins: tuple[int, ...]  # groups of these particles after the release
    phase: int  # of the body
    region: Any  # preprocess/pinned_regions.py


def pinned_plans(
    groups: tuple[GroupPlan, ...], group_of: tuple[int, ...], regions: Sequence
) -> tuple[tuple[PinnedPlan, ...], tuple[GroupPlan, ...]]:
    """Plan the pinned parts and their groups.

    Args:
        groups: Groups as if nothing were pinned.
        group_of: Group of each object and inlet, likewise.
        regions: Pinned parts with their particles.

    Returns:
        The plans, and the groups with those of the parts behind them.
    """
    plans, every = [], list(groups)
    for region in regions:
        phase = groups[group_of[region.object]].phase
        numbers = tuple(range(len(every), len(every) + len(region.shares)))
        pairs = [(group.phase, group.material) for group in groups]
        joins = tuple(pairs.index((phase, share.material)) for share in region.shares)
        plans.append(PinnedPlan(region.object, numbers, joins, phase, region))
        is_moving = region.is_free or region.course is not None
        cost = MOVING_PINNED_COST if is_moving else PINNED_COST
        for free in (groups[number] for number in joins):
            name = f"{region.name} (pinned to {region.to})/{free.material}"
            every.append(free._replace(name=name, pinned=True, cost=cost))
    return tuple(plans), tuple(every)


def set_pinned_groups(pins: Sequence[PinnedPlan], ids: np.ndarray, groups: np.ndarray) -> None:
    """Set the groups of the particles that are held at the start.

    Args:
        pins: Pinned parts.
        ids: Particle ids, shape (n,).
        groups: Their groups (in/out), shape (n,).
    """
    for part in pins:
        for group, share in zip(part.groups, part.region.shares, strict=True):
            run = np.searchsorted(share.runs[:, 0], ids, side="right") - 1
            groups[(run >= 0) & (ids <= share.runs[run, 1])] = group
