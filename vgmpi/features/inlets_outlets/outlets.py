"""Outlets: particles inside an outlet are removed from their groups after every fourth step."""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.particle_insertion import bounds_of_idle_group, remove_particles
from vgmpi.gaussians.shape_distance import distance
from vgmpi.kernels.step_records import ParticleBounds, StepReport, StepSpan
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.inlet_schedule import OutletPlan
from vgmpi.preprocess.shape_sdf import blend_overhang, support

INTERVAL = 4  # [steps] counted by step number, so that a restart does not shift the removals
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


class Outlets(ActiveFeature):
    """Outlets of a run."""

    def __init__(self, context: StartContext):
        """Hold the outlets of the plan and the accounting that counts removed particles."""
        self.plan, self.groups = context.plan, context.groups
        self.flow: Any = context.features["flow_accounting"]
        self.move_particles = context.move_particles
        self.regions = [_Region(sink) for sink in self.plan.sinks]

    def end_step(self, span: StepSpan, report: StepReport) -> StepReport:
        """Remove this rank's particles inside an outlet, after every INTERVAL steps."""
        if span.number % INTERVAL == 0:
            removed = [self._remove_from(group, g, span.end) for g, group in enumerate(self.groups)]
            if any(removed):  # others on this rank have new indices
                self.move_particles()
        return report

    def adjust_bounds(self, span: StepSpan, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of the next step; those of an idle group if no particle is left."""
        return bounds if bounds.rate else bounds_of_idle_group(self.plan)

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
                self.flow.remove(g, group.get("vol0", indices[inside])[:, 0])
                remove_particles(group, indices[inside])
        return any_removed


def start(context: StartContext) -> Outlets | None:
    """Return the outlets of a run, or None if it has none."""
    return Outlets(context) if context.plan.sinks else None
