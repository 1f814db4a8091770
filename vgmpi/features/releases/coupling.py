"""Releases: prescribed bodies join the groups in which they move freely, and walls vanish."""

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.particle_insertion import bounds_of_particles, remove_particles
from vgmpi.kernels.step_records import ParticleBounds, StepMaxima, StepSpan
from vgmpi.parallel.migration import append_particles
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.feature_plan import TIME_TOLERANCE, ReleasedParticles, ReleaseLayer
from vgmpi.scene.rigid_motion import Trajectories, Trajectory, spin_tensor

from .plan import ReleasesPlan


class Releases(ActiveFeature):
    """Scheduled releases of a run.

    They depend on the time alone, so all ranks release together. A sort must follow a release.
    """

    def __init__(self, releases: ReleasesPlan, context: StartContext):
        """Sort the release layers by time."""
        self.plan, self.wall_opening_times = context.plan, releases.wall_opening_times
        self.ranks, self.groups, self.engine = context.ranks, context.groups, context.engine
        self.features = context.features
        self.has_released = False  # in the present step
        self.layers = sorted(
            ((layer, each) for each in releases.particles for layer in each.layers),
            key=lambda pair: pair[0].time,
        )

    def next(self, time: float) -> float:
        """Return the time [s] of the next release after `time`; infinite if there is none."""
        times = [layer.time for layer, _ in self.layers]
        times += [opens for opens in self.wall_opening_times if opens is not None]
        return min((event for event in times if event > time * TIME_TOLERANCE), default=np.inf)

    def open_walls(self, time: float) -> None:
        """Open the walls that have vanished by `time` [s]."""
        for wall, opens in enumerate(self.wall_opening_times):
            if opens is not None and opens <= time * TIME_TOLERANCE:
                self.engine.open(wall)

    def next_event(self, time: float, goal: float) -> float:
        """Return the time [s], at most `goal`, at which the time steps must land next."""
        next_release = self.next(time)
        return next_release if next_release * TIME_TOLERANCE < goal else goal

    def due(self, before: float, time: float) -> bool:
        """Return whether something is released after `before` and not after `time` [s]."""
        return self.next(before) <= time * TIME_TOLERANCE

    def adjust_bounds(self, span: StepSpan, bounds: ParticleBounds) -> ParticleBounds:
        """Release the bodies and walls that are due; include the bounds of their particles."""
        self.has_released = self.due(span.start, span.end)
        if not self.has_released:
            return bounds
        self.correction_origin, bounds_of_released = span.number, ParticleBounds()
        self.open_walls(span.end)
        for layer, particles in self.layers:
            if span.start * TIME_TOLERANCE < layer.time <= span.end * TIME_TOLERANCE:
                bounds_of_released = bounds_of_released.merge(
                    self._release_layer(self.groups, layer, particles)
                )
        return bounds.merge(ParticleBounds(*self.ranks.max(np.array(bounds_of_released)).tolist()))

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Return whether something was released in the step."""
        return self.has_released

    def saved(self) -> dict:
        """Return the step of the last release."""
        return {"since": self.correction_origin}

    def place_saved(self, attrs: dict, time: float) -> None:
        """Open the walls that have vanished, and restore the step of the last release.

        Args:
            attrs: Attributes of the checkpoint.
            time: Time of the checkpoint [s].
        """
        self.correction_origin = attrs.get("since", 0)
        self.open_walls(time)

    def _release_layer(
        self, groups: list[ParticleGroup], layer: ReleaseLayer, released: ReleasedParticles
    ) -> ParticleBounds:
        """Move the particles of a release layer to the group that their body joins.

        Returns:
            Their bounds.
        """
        group, target = groups[released.group], groups[released.group_after_release]
        indices = group.index()
        height = group.positions_at(indices)[:, 2]
        indices = indices[(layer.low <= height) & (height < layer.high)]
        if not len(indices):
            return ParticleBounds()
        if released.course is not None:
            _launch(group, indices, released.course, layer.time)
        elif group.plan.carrier:  # a load may have changed what nothing reads
            group.put("v", indices, np.zeros((len(indices), 3)))
            group.put("C", indices, np.zeros((len(indices), 9)))
        block = group.block[group.segment_of(indices)]
        xi, channels, ids = (
            group.xi[:, indices],
            group.f[:, indices],
            group.ids[indices],
        )  # these are copies
        limits = bounds_of_particles(self.plan, group, indices)
        remove_particles(group, indices)
        append_particles(target, block, xi, channels, ids)
        volume = channels[group.plan.channels["vol0"].first]
        for feature in self.features.values():
            feature.count_transferred(released.group, released.group_after_release, volume)
        return limits


def _launch(group: ParticleGroup, indices: np.ndarray, course: Trajectory, time: float) -> None:
    """Give the particles `at` (n,) the velocity of their prescribed motion at its end."""
    v, spin = course.rates(time)
    displacement = Trajectories([course]).poses(time)[1][0]
    x = group.positions_at(indices) - (np.array(course.about) + displacement)
    group.put("v", indices, v + np.cross(spin, x))
    group.put("C", indices, np.tile(spin_tensor(spin), (len(indices), 1)))
