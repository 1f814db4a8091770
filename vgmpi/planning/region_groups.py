"""Regions of bodies: their particles belong to the group of another material in the body's phase.

Regions add no kernel and no array: a group is one material in one phase, and a phase may hold any
number of groups.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from .plan import Plan


class RegionPlan(NamedTuple):
    """Region of a body."""

    object: int  # row of the object
    group: int  # group of its particles
    first: int  # id of its first particle
    particles: int  # number of its particles


def region_plans(plan: "Plan", entries: list[dict]) -> tuple[RegionPlan, ...]:
    """Return the regions of all bodies, in the order of the objects.

    Args:
        plan: The plan.
        entries: Entries of the objects and particle sources in output files.
    """
    free = [g for g, group in enumerate(plan.groups) if not group.carrier]
    number = {(plan.groups[g].phase, plan.groups[g].material): g for g in free}
    plans = []
    for k, entry in enumerate(entries):
        for part in entry.get("regions", ()):
            group = number[plan.groups[plan.group_of[k]].phase, part["material"]]
            plans.append(RegionPlan(k, group, part["first_row"], part["row_count"]))
    return tuple(plans)


def group_counts(plan: "Plan") -> list[tuple[int, int]]:
    """Return (particles, group) of each object and source without its parts, then of each part.

    Parts are regions and those of features. The group of scenery is -1.
    """
    counts = list(plan.count)
    parts = [(region.object, region.particles, region.group) for region in plan.regions]
    parts += [part for feature in plan.features for part in feature.parts()]
    for number, particles, _ in parts:
        counts[number] -= particles
    own = list(zip(counts, plan.group_of, strict=True))
    return own + [(particles, group) for _, particles, group in parts]


def groups_of_particles(plan: "Plan", ids: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return the group (n,) of each particle at the start.

    Args:
        plan: The plan.
        ids: Particle ids, shape (n,).
        owner: Object or particle source of each particle, shape (n,).
    """
    groups = np.array(plan.group_of)[owner] if len(owner) else np.zeros(0, np.int64)
    for region in plan.regions:
        is_inside = (owner == region.object) & (ids >= region.first)
        groups[is_inside & (ids < region.first + region.particles)] = region.group
    for feature in plan.features:
        feature.assign_groups(ids, groups)
    return groups
