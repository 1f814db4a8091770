"""Inlets and outlets: particles are spawned by layers, carried to the mouth, released one by one.

The place of a particle in a nozzle follows from its id and the time alone (plan.py), so a release
suits the particle at any time, on any number of ranks and after a restart. Until its release a
particle has the inlet's velocity and the reference state, whatever the grid says. It is released a
little before the mouth (RELEASE_OFFSET_CELLS of plan.py), so that its fall begins there. Particles
inside an outlet are removed after every fourth step.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext, WallInflow
from vgmpi.features.particle_insertion import (
    ParticleRows,
    bounds_of,
    bounds_of_idle_group,
    remove_particles,
)
from vgmpi.gaussians.shape_distance import distance
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.io.checkpoint import Checkpoint
from vgmpi.kernels.step_records import ParticleBounds, StepMaxima, StepReport, StepSpan
from vgmpi.parallel.block_lattice import BITS, BLOCK_CENTER, BLOCK_EDGE
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.shape_sdf import blend_overhang, support

from . import geometry
from .flow_accounting import FlowAccounting
from .plan import InletPlan, InletsOutletsPlan, OutletPlan

MAX_WAY_CELLS = 1.4  # [cells] of a particle between removals: half a cell beyond a wall it is lost
STRAY_CELLS = 4.0  # [cells] greatest distance of a particle from its block's center between sorts
STATIC_CHANNELS = ("vol0", "color", "surface")  # channels that a nozzle particle keeps


class _Carried(NamedTuple):
    """Particles of this rank in the nozzle of an inlet, as of the last sort."""

    source: InletPlan
    group: ParticleGroup
    indices: np.ndarray  # (n,) indices in the group
    block: np.ndarray  # (n, 3) block coordinates
    ids: np.ndarray  # (n,)
    release_time: np.ndarray  # (n,) [s] release times

    def after(self, time: float) -> "_Carried":
        """Return the particles whose release time is after `time` [s]."""
        remaining = self.release_time > time
        if remaining.all():
            return self
        return self._replace(
            indices=self.indices[remaining],
            block=self.block[remaining],
            ids=self.ids[remaining],
            release_time=self.release_time[remaining],
        )


def wall_inflow(inlet: InletPlan, plan: Plan) -> WallInflow | None:
    """Return what an inlet brings through a wall of the domain, or None: it begins inside.

    Args:
        inlet: The inlet.
        plan: Plan of the run.
    """
    direction, cells = np.array(inlet.direction), plan.cells
    axis = int(np.argmax(np.abs(direction)))
    start = inlet.mouth - inlet.nozzle_layers * inlet.spacing * direction
    wall = 0 if direction[axis] > 0 else cells[axis]
    distance_to_wall = np.abs(start[:, axis] / plan.dx - wall).max()
    if np.count_nonzero(direction) > 1 or distance_to_wall > geometry.TOUCH_TOLERANCE_CELLS:
        return None
    nodes, weights = geometry.wall_weights(start / plan.dx, axis, cells)
    parts = weights * (inlet.spacing / plan.dx) ** 2
    begin = float(inlet.spawn_time(0)) if inlet.start > 0 else -np.inf
    end = float(inlet.spawn_time(inlet.particles - 1))
    return WallInflow(nodes, parts[:, None] * inlet.velocity, begin, end)


class Inlets:
    """Inlets of a run."""

    def __init__(self, inlets: tuple[InletPlan, ...], context: StartContext):
        """Compute the bounds that hold while an inlet is active."""
        self.inlets, self.plan, self.ranks = inlets, context.plan, context.ranks
        self.groups, self.insert = context.groups, context.insert
        self.carried: list[_Carried] = []
        self.active_bounds, plan = ParticleBounds(), self.plan  # bounds of active inlets
        for source in inlets:
            group, v = plan.groups[source.group], source.velocity[None]
            own = bounds_of(plan, group, [group.reference], v, np.zeros((1, 9)))
            self.active_bounds = self.active_bounds.merge(own)
        ends = [source.mouth_time(source.particles - 1) for source in inlets]
        self.last_passage = max(ends, default=-np.inf)

    def initial_particles(self, rows: list[ParticleRows]) -> list[ParticleRows]:
        """Return the particles at the start: without those to come, with those of first layers."""
        if self.inlets:
            rows = [each.select(each.ids < self.inlets[0].first) for each in rows]
        return [*rows, *self.spawn(None, 0.0)]

    def merge_bounds(self, bounds: ParticleBounds, time: float) -> ParticleBounds:
        """Return the bounds of the particles and of inlets that are active at a time [s]."""
        return bounds.merge(self.active_bounds) if time <= self.last_passage else bounds

    def insert_layers(self, span: StepSpan) -> bool:
        """Insert the layers that are due; return whether there are any."""
        is_due = self.due(span.start, span.end)
        if is_due:
            self.insert(self.spawn(span.start, span.end))
        return is_due

    def find_particles(self, time: float) -> None:
        """Locate the particles in the nozzles."""
        self.carried = []
        for source in self.inlets:
            group = self.groups[source.group]
            first = source.first + source.released(time)
            last = source.first + source.spawned(time)
            indices = group.index()
            indices = indices[(group.ids[indices] >= first) & (group.ids[indices] < last)]
            block, ids = group.block[group.segment_of(indices)], group.ids[indices]
            let_go = source.release_time(ids - source.first)
            self.carried.append(_Carried(source, group, indices, block, ids, let_go))

    def move_particles(self, time: float, report: StepReport) -> StepReport:
        """Move the nozzle particles to their places, and release those that are due.

        Returns:
            The step's report, with the distance of nozzle particles from their blocks' centers.
        """
        distance = report.stray
        for carried in self.carried:
            if len(carried.indices):
                distance = max(distance, self._set_positions(carried, time))
        self.reset_nozzle_velocity()
        self.carried = [carried.after(time) for carried in self.carried]
        return report._replace(stray=distance)

    def end_correction(self, time: float, moves: bool) -> None:
        """Reset what a step of no time has changed of the nozzle particles.

        Args:
            time, moves: See `ActiveFeature.end_correction`.
        """
        if moves:
            for carried in self.carried:
                if len(carried.indices):
                    self._set_positions(carried, time)
        self.reset_nozzle_velocity()

    def _set_positions(self, carried: _Carried, time: float) -> float:
        """Set the positions of nozzle particles.

        Returns:
            Largest distance [cells] of one from its block's center.
        """
        bits, group = BITS[np.dtype(self.plan.real)], carried.group
        x = carried.source.places(carried.ids, time) / self.plan.dx - (
            BLOCK_EDGE * carried.block + BLOCK_CENTER
        )
        xi = np.rint(np.ldexp(x, bits)).astype(np.int64)
        group.xi[:, carried.indices] = xi.T.astype(group.xi.dtype)
        return float(np.ldexp(np.abs(xi).max().astype(float), -bits))

    def reset_nozzle_velocity(self) -> None:
        """Reset the nozzle particles to the inlet's velocity and the reference state."""
        for carried in self.carried:
            for channel in carried.group.plan.channels if len(carried.indices) else ():
                if channel.name not in STATIC_CHANNELS:
                    carried.group.f[channel.rows, carried.indices] = np.array(channel.reference)[
                        :, None
                    ]
            if len(carried.indices):
                carried.group.put(
                    "v",
                    carried.indices,
                    np.tile(carried.source.velocity, (len(carried.indices), 1)),
                )

    def due(self, before: float | None, time: float) -> bool:
        """Return whether a layer is spawned after `before` [s] (None: the start), up to `time`."""
        return any(first < last for first, last in self._spans(before, time))

    def _spans(self, before: float | None, time: float) -> list[tuple[int, int]]:
        """Return the half-open range of particles that each inlet spawns in the interval."""
        return [
            (0 if before is None else source.spawned(before), source.spawned(time))
            for source in self.inlets
        ]

    def spawn(self, before: float | None, time: float) -> list[ParticleRows]:
        """Return the particles spawned in the interval, all on rank 0; a sort distributes them."""
        if self.ranks.rank != 0:
            return []
        spans = zip(self.inlets, self._spans(before, time), strict=True)
        return [self._rows(source, *span, time) for source, span in spans if span[0] < span[1]]

    def _rows(self, source: InletPlan, first: int, last: int, time: float) -> ParticleRows:
        """Return the particles with the numbers `first` to `last` (exclusive) of an inlet."""
        ids = source.first + np.arange(first, last)
        v = np.tile(source.velocity, (len(ids), 1))
        sh = np.zeros((len(ids), 1, 3))
        sh[:, 0] = dc_from_rgb(np.array(source.color)).astype(np.float32)  # single, as in files
        return ParticleRows(
            source.places(ids, time),
            v,
            np.full(len(ids), source.volume),
            ids,
            np.full(len(ids), source.entity),
            sh=sh,
        )


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


class Outlets:
    """Outlets of a run."""

    def __init__(
        self, outlets: tuple[OutletPlan, ...], flow: FlowAccounting, context: StartContext
    ):
        """Hold the outlets and the accounting that counts removed particles."""
        self.plan, self.groups, self.flow = context.plan, context.groups, flow
        self.note_moved = context.move_particles
        self.regions = [_Region(outlet) for outlet in outlets]
        # by step number, so that a restart does not shift it
        self.interval = int(MAX_WAY_CELLS / context.plan.time_step.max_cells)  # [steps]

    def remove_particles(self, span: StepSpan) -> None:
        """Remove this rank's particles inside an outlet, after every `interval` steps."""
        if self.regions and span.number % self.interval == 0:
            removed = [self._remove_from(group, g, span.end) for g, group in enumerate(self.groups)]
            if any(removed):  # others on this rank have new indices
                self.note_moved()

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


class InletsOutlets(ActiveFeature):
    """Inlets, outlets and the accounting of what enters and leaves on one rank."""

    def __init__(self, plan: InletsOutletsPlan, context: StartContext):
        """Set up the inlets and outlets of a plan."""
        self.plan, self.flow = context.plan, FlowAccounting(context)
        self.inlets = Inlets(plan.inlets, context)
        self.outlets = Outlets(plan.outlets, self.flow, context)
        flows = [wall_inflow(inlet, self.plan) for inlet in plan.inlets]
        self.wall_inflows = [flow for flow in flows if flow is not None]

    def initial_particles(self, rows: list[ParticleRows]) -> list[ParticleRows]:
        """Return the particles at the start, with those of first layers."""
        return self.inlets.initial_particles(rows)

    def begin_run(self, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of the particles and of active inlets at the start."""
        return self.inlets.merge_bounds(bounds, 0.0)

    def saved(self) -> dict:
        """Return the totals of all ranks. Collective."""
        return {"flow": self.flow.totals()}

    def restore(self, saved: Checkpoint) -> None:
        """Restore the totals of all ranks.

        Args:
            saved: The checkpoint.
        """
        self.flow.restore(saved)

    def find_particles(self, time: float) -> None:
        """Locate the particles in the nozzles."""
        self.inlets.find_particles(time)

    def count_inserted(self, rows: ParticleRows) -> None:
        """Count the particles that entered on this rank."""
        self.flow.insert(rows)

    def count_transferred(self, group: int, other: int, volume: np.ndarray) -> None:
        """Count particles that moved from one group to another.

        Args:
            group, other, volume: See `ActiveFeature.count_transferred`.
        """
        self.flow.transfer(group, other, volume)

    def carried_particles(self, group: ParticleGroup) -> np.ndarray:
        """Return the indices (n,) of particles of a group that are in a nozzle."""
        carried = [each.indices for each in self.inlets.carried if each.group is group]
        return np.concatenate([np.zeros(0, np.int64), *carried])

    def end_correction(self, time: float, moves: bool) -> None:
        """Reset what a step of no time, at `time` [s], has changed of the nozzle particles."""
        self.inlets.end_correction(time, moves)

    def end_step(self, span: StepSpan, report: StepReport) -> StepReport:
        """Move the nozzle particles, then remove those in outlets."""
        report = self.inlets.move_particles(span.end, report)
        self.outlets.remove_particles(span)
        return report

    def adjust_bounds(self, span: StepSpan, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of the next step; those of an idle group while there is no particle."""
        bounds = bounds if bounds.rate else bounds_of_idle_group(self.plan)
        return self.inlets.merge_bounds(bounds, span.end)

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Insert the layers that are due; return whether there are any."""
        return self.inlets.insert_layers(span)

    def phase_entries(self) -> list[dict[str, float]]:
        """Return what came, what went and what is present of each phase. Collective."""
        return self.flow.phase_entries()
