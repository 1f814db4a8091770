"""Groups of the particles of pinned parts: carried by what holds them, outside of the grid."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .phases_and_groups import GroupPlan

PINNED_COST = 0.1  # [-] cost of a carried particle relative to a fluid's (estimate)


class PinnedPlan(NamedTuple):
    """Pinned part of a body."""

    object: int  # row of the body
    group: int  # of its particles
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
        The plans, and all groups with those of the parts last.
    """
    plans, every = [], list(groups)
    for region in regions:
        free = groups[group_of[region.object]]
        name = f"{region.name} (pinned to {region.to})/{free.material}"
        plans.append(PinnedPlan(region.object, len(every), free.phase, region))
        every.append(free._replace(name=name, pinned=True, cost=PINNED_COST))
    return tuple(plans), tuple(every)


def groups_of_particles(
    group_of: Sequence[int], pins: Sequence[PinnedPlan], ids: np.ndarray, owner: np.ndarray
) -> np.ndarray:
    """Return the group of each particle at the start, shape (n,).

    Args:
        group_of: Group of each object and inlet.
        pins: Pinned parts.
        ids: Particle ids, shape (n,).
        owner: Object or inlet of each particle, shape (n,).
    """
    result = np.array(group_of)[owner] if len(owner) else np.zeros(0, np.int64)
    for part in pins:
        runs = part.region.runs
        run = np.searchsorted(runs[:, 0], ids, side="right") - 1
        result[(run >= 0) & (ids <= runs[run, 1])] = part.group
    return result
