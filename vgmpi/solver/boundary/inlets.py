"""Emission by inlets: particles are spawned by layers, carried to the mouth, released one by one.

The place of a particle in a nozzle follows from its id and the time alone
(planning/inlet_schedule.py), so a release suits the particle at any time, on any number of ranks
and after a restart. Until its release a particle has the inlet's velocity and the reference state,
whatever the grid says. It is released a little before the mouth (RELEASE_OFFSET_CELLS of
planning/inlet_schedule.py), so that its fall begins there.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.parallel.block_lattice import BITS, BLOCK_CENTER, BLOCK_EDGE
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.inlet_schedule import InletPlan
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.engine_protocol import StepReport

from .particle_insertion import ParticleRows, bounds

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


class Sources:
    """Inlets of a run.

    Call `find` after every sort, `advect_nozzle` after every step, `reset_nozzle` after
    every zero-length step, and `spawn` before a sort whenever a layer is `due`.
    """

    def __init__(self, plan: Plan, ranks: SerialCommunicator):
        """Compute the bounds that hold while an inlet is active."""
        self.plan, self.ranks = plan, ranks
        self.carried: list[_Carried] = []
        self.active_bounds = np.zeros(4)  # bounds (particle_insertion.bounds) of active inlets
        for source in plan.sources:
            group, v = plan.groups[source.group], source.velocity[None]
            limits = bounds(plan, group, [group.rest], v, np.zeros((1, 9)))
            self.active_bounds = np.maximum(self.active_bounds, limits)
        self.last_passage = max(source.mouth_time(source.particles - 1) for source in plan.sources)

    def merge_bounds(self, limits: np.ndarray, time: float) -> np.ndarray:
        """Merge bounds (rate, speed, turn, stress) of the particles with those of active inlets."""
        return np.maximum(limits, self.active_bounds) if time <= self.last_passage else limits

    def find(self, groups: list[ParticleGroup], time: float) -> None:
        """Locate the particles in the nozzles."""
        self.carried = []
        for source in self.plan.sources:
            group = groups[source.group]
            first = source.first + source.released(time)
            last = source.first + source.spawned(time)
            indices = group.index()
            indices = indices[(group.ids[indices] >= first) & (group.ids[indices] < last)]
            block, ids = group.block[group.segment_of(indices)], group.ids[indices]
            let_go = source.release_time(ids - source.first)
            self.carried.append(_Carried(source, group, indices, block, ids, let_go))

    def advect_nozzle(self, report: StepReport, time: float) -> StepReport:
        """Move the nozzle particles to their places at `time` [s], and release those that are due.

        Returns:
            The step's report, with the distance of nozzle particles from their blocks' centers.
        """
        distance = report.far
        for carried in self.carried:
            if len(carried.indices):
                distance = max(distance, self._set_positions(carried, time))
        self.reset_nozzle_velocity()
        self.carried = [carried.after(time) for carried in self.carried]
        return report._replace(far=distance)

    def reset_nozzle(self, time: float) -> None:
        """Reset what a step of no time, at `time` [s], has changed of the nozzle particles."""
        if self.plan.shift_interval:
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
                    carried.group.f[channel.rows, carried.indices] = np.array(channel.rest)[:, None]
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
            for source in self.plan.sources
        ]

    def spawn(self, before: float | None, time: float) -> list[ParticleRows]:
        """Return the particles spawned in the interval, all on rank 0; a sort distributes them."""
        if self.ranks.rank != 0:
            return []
        spans = zip(self.plan.sources, self._spans(before, time), strict=True)
        return [self._rows(source, *span, time) for source, span in spans if span[0] < span[1]]

    def _rows(self, source: InletPlan, first: int, last: int, time: float) -> ParticleRows:
        """Return the particles with the numbers `first` to `last` (exclusive) of an inlet."""
        ids = source.first + np.arange(first, last)
        v = np.tile(source.velocity, (len(ids), 1))
        sh = np.zeros((len(ids), self._coefficients(), 3))
        sh[:, 0] = dc_from_rgb(np.array(source.color)).astype(np.float32)  # single, as in files
        return ParticleRows(
            source.places(ids, time),
            v,
            np.full(len(ids), source.volume),
            ids,
            np.full(len(ids), source.entity),
            sh=sh,
        )

    def _coefficients(self) -> int:
        """Return the number of color coefficients of the group that has most."""
        return max(1, *(group.coefficients for group in self.plan.groups))
