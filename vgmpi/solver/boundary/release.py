"""Releases: prescribed bodies join the groups in which they move freely, and walls vanish."""

import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.migration import append_particles
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.planning.prescribed_bodies import PrescribedBodyPlan, ReleaseLayer
from vgmpi.scene.rigid_motion import Trajectories, Trajectory, spin_tensor
from vgmpi.solver.engines.engine_protocol import Engine

from .flow_accounting import Tally
from .outlets import remove
from .particle_insertion import bounds_of_particles

TIME_TOLERANCE = 1.0 + 1e-12  # [-] ratio below which two times count as equal


class Releases:
    """Scheduled releases of a run.

    They depend on the time alone, so all ranks release together. A sort must follow a release.
    """

    def __init__(self, plan: Plan, tally: Tally | None, engine: Engine):
        """Sort the release layers by time."""
        self.plan, self.tally, self.engine = plan, tally, engine
        bodies = [*plan.driven, *_released_parts(plan)]
        self.layers = sorted(
            ((layer, body) for body in bodies for layer in body.layers),
            key=lambda pair: pair[0].time,
        )

    def next(self, time: float) -> float:
        """Return the time [s] of the next release after `time`; infinite if there is none."""
        times = [layer.time for layer, _ in self.layers]
        times += [opens for opens in self.plan.opens if opens is not None]
        return min((event for event in times if event > time * TIME_TOLERANCE), default=np.inf)

    def open_walls(self, time: float) -> None:
        """Open the walls that have vanished by `time` [s]."""
        for wall, opens in enumerate(self.plan.opens):
            if opens is not None and opens <= time * TIME_TOLERANCE:
                self.engine.open(wall)

    def next_landing(self, time: float, goal: float) -> float:
        """Return the time [s], at most `goal`, at which the time steps must land next."""
        next_release = self.next(time)
        return next_release if next_release * TIME_TOLERANCE < goal else goal

    def due(self, before: float, time: float) -> bool:
        """Return whether something is released after `before` and not after `time` [s]."""
        return self.next(before) <= time * TIME_TOLERANCE

    def release(
        self, groups: list[ParticleGroup], before: float, time: float, ranks: SerialCommunicator
    ) -> np.ndarray:
        """Release the bodies and walls that are due. Collective.

        Args:
            groups: Particle groups (in/out).
            before: Time at the start of the step [s].
            time: Time at its end [s].
            ranks: Communicator.

        Returns:
            Bounds of time steps and sums for the released particles, shape (4,), see
            particle_insertion.bounds.
        """
        limits = np.zeros(4)
        self.open_walls(time)
        for layer, body in self.layers:
            if before * TIME_TOLERANCE < layer.time <= time * TIME_TOLERANCE:
                limits = np.maximum(limits, self._release_layer(groups, layer, body))
        return ranks.max(limits)

    def _release_layer(
        self, groups: list[ParticleGroup], layer: ReleaseLayer, body: PrescribedBodyPlan
    ) -> np.ndarray:
        """Move the particles of a release layer to the group that their body joins.

        Returns:
            Their bounds, see particle_insertion.bounds.
        """
        group, target = groups[body.group], groups[body.joins]
        indices = group.index()
        height = group.positions_at(indices)[:, 2]
        indices = indices[(layer.low <= height) & (height < layer.high)]
        if not len(indices):
            return np.zeros(4)
        if body.course is not None:
            _launch(group, indices, body.course, layer.time)
        elif group.plan.pinned:  # a load may have changed what nothing reads
            group.put("v", indices, np.zeros((len(indices), 3)))
            group.put("C", indices, np.zeros((len(indices), 9)))
        block = group.block[group.segment_of(indices)]
        xi, channels, ids = (
            group.xi[:, indices],
            group.f[:, indices],
            group.ids[indices],
        )  # these are copies
        limits = bounds_of_particles(self.plan, group, indices)
        remove(group, indices)
        append_particles(target, block, xi, channels, ids)
        if self.tally is not None:
            volume = channels[group.plan.channels["vol0"].first]
            self.tally.transfer(body.group, body.joins, volume)
        return limits


def _launch(group: ParticleGroup, indices: np.ndarray, course: Trajectory, time: float) -> None:
    """Give the particles `at` (n,) the velocity of their prescribed motion at its end."""
    v, spin = course.rates(time)
    displacement = Trajectories([course]).poses(time)[1][0]
    x = group.positions_at(indices) - (np.array(course.about) + displacement)
    group.put("v", indices, v + np.cross(spin, x))
    group.put("C", indices, np.tile(spin_tensor(spin), (len(indices), 1)))


def _released_parts(plan: Plan) -> list[PrescribedBodyPlan]:
    """Return the pinned parts that let go at a time, by groups, as bodies that are released."""
    parts = []
    for part in plan.pins:
        if (time := part.region.release_time) == np.inf:
            continue
        layers = (ReleaseLayer(time, -np.inf, np.inf),)
        for group, joins in zip(part.groups, part.joins, strict=True):
            body = PrescribedBodyPlan(
                (part.object,), group, joins, part.region.course, (0.0,) * 3, 0.0, layers
            )
            parts.append(body)
    return parts
