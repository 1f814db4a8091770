"""Outlets: particles inside an outlet are removed from their groups after every fourth step."""

import numpy as np

from vgmpi.gaussians.shape_distance import distance
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.inlet_schedule import OutletPlan
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.shape_sdf import blend_overhang, support

from .flow_accounting import Tally

EVERY = 4  # [steps] counted by step number, so that a restart does not shift the removals
STRAY_CELLS = 4.0  # [cells] greatest distance of a particle from its block's center between sorts


class _Region:
    """Outlet with its bounding box."""

    def __init__(self, sink: OutletPlan):
        self.shape, self.since = sink.shape, sink.since
        axes = np.eye(3)
        margin = blend_overhang(sink.shape)
        self.low = np.array([-support(sink.shape, -axis) for axis in axes]) - margin
        self.high = np.array([support(sink.shape, axis) for axis in axes]) + margin

    def may_contain(self, group: ParticleGroup, dx: float) -> np.ndarray:
        """Return a mask (segments,) of the segments that may have particles inside the outlet."""
        middle, margin = (4 * group.block + 1.5) * dx, STRAY_CELLS * dx
        inside = (middle >= self.low - margin) & (middle <= self.high + margin)
        return np.asarray(inside.all(axis=1))


class Sinks:
    """Outlets of a run."""

    def __init__(self, plan: Plan, tally: Tally):
        """Hold the outlets of the plan and the accounting that counts removed particles."""
        self.plan, self.tally = plan, tally
        self.regions = [_Region(sink) for sink in plan.sinks]

    def remove_particles(self, groups: list[ParticleGroup], step: int, time: float) -> bool:
        """Remove this rank's particles inside an outlet, if `step` is a multiple of EVERY.

        Args:
            groups: Particle groups (in/out).
            step: Number of the step that has just ended.
            time: Time at its end [s].

        Returns:
            Whether any particle was removed, so that others on this rank have new indices.
        """
        if step % EVERY:
            return False
        removed = [self._remove_from(group, g, time) for g, group in enumerate(groups)]
        return any(removed)

    def _remove_from(self, group: ParticleGroup, g: int, time: float) -> bool:
        """Remove a group's particles inside outlets; return whether there were any."""
        any_removed = False
        for region in self.regions:
            if time < region.since:
                continue
            segments = np.flatnonzero(region.may_contain(group, self.plan.dx) & (group.count > 0))
            if not len(segments):
                continue
            indices = group.places(segments)
            inside = distance(region.shape, group.positions_at(indices)) < 0
            if inside.any():
                any_removed = True
                self.tally.remove(g, group.get("vol0", indices[inside])[:, 0])
                remove(group, indices[inside])
        return any_removed


def remove(group: ParticleGroup, indices: np.ndarray) -> None:
    """Remove particles from their segments; the others move up in order.

    Freed slots are cleared as a sort leaves them. Segments stay until the next sort, even if they
    are empty: the exchange tables follow from the segments, here and in a run that restarts from a
    checkpoint.

    Args:
        group: Particle group (in/out).
        indices: Indices of the particles to remove, shape (n,).
    """
    segment_of = group.segment_of(indices)
    segments = np.unique(segment_of)
    old_slots = group.places(segments)
    survivors = old_slots[~np.isin(old_slots, indices)]
    group.count = group.count - np.bincount(segment_of, minlength=len(group.count))
    new_slots = group.places(segments)
    freed_slots = np.setdiff1d(old_slots, new_slots, assume_unique=True)
    for rows, blank in ((group.xi, 0), (group.f, 0), (group.ids[None], -1)):
        rows[:, new_slots] = rows[:, survivors]  # the right-hand side is a copy
        rows[:, freed_slots] = blank
