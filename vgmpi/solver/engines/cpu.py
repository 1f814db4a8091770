"""CPU engine: kernel calls of a time step, in compiled code on the processor's cores."""

import math
from typing import Any

import numpy as np

from vgmpi.features.active_feature import NodeState, carrier_of, reserved_nodes
from vgmpi.kernels import reproducible_sums
from vgmpi.kernels.grid import update
from vgmpi.kernels.nodal_fields import carried_values
from vgmpi.kernels.rigid.prescribed_motion import ROTATED_CHANNELS
from vgmpi.kernels.rigid.prescribed_transfer import advect_prescribed
from vgmpi.kernels.step_records import (
    FAILED_ID,
    FAILURE,
    GRADIENT2,
    MAXIMA,
    RATE,
    SPEED,
    STRAY,
    AccumulatorOverflow,
    StepReport,
    dither_of_step,
)
from vgmpi.kernels.transfer import g2p, p2g, transfer_correction
from vgmpi.parallel.block_lattice import BITS
from vgmpi.parallel.halo_exchange import FieldMessage

from . import surface_fields
from .compiled_engine import CompiledEngine
from .group_context import auxiliary_gather_kind, particles_of


class Cpu(CompiledEngine):
    """Particles and nodes of one rank on `threads` threads; see solver/engines/engine_protocol.py.

    Threads add to the same nodes. Where two of them would do so at the same time, all but the first
    add to copies, which are merged before the sums are read. This changes no bit of the sums.
    """

    def fill(self, border: bool) -> None:
        """Scatter the contributions of the particles to the sums."""
        self.each(self._fill, border)
        if border and self.threads > 1:
            for name, layer in self.layers.items():
                if len(layer.phase) and self._is_summed(name):
                    reproducible_sums.merge_thread_copies(
                        self.merged_rows, self.blocks, layer.tables
                    )

    def _fill(self, thread: int, border: bool) -> None:
        dt = self.plan.real.type(self.dt)
        for g, part in enumerate(self.parts):
            group = part.group
            rows = part.partition.stage(border)[thread]
            if not self.dt:
                if group.plan.is_carried:  # given motion loses nothing in transfers
                    continue
                for layer, kind, chosen in part.timeless:
                    if self._is_summed(layer):
                        self.call_if_rows(
                            ("still", layer), p2g.particles_to_grid, rows[chosen[rows]], kind, None,
                            part.segments, particles_of(part.group), self.layers[layer].sums,
                            self.memory.scratch[thread], dt, self._ghosts(part, thread, layer),
                        )  # fmt: skip
                continue
            for k, contribution in enumerate(part.contributions):
                self.call_if_rows(
                    (g, k), p2g.particles_to_grid, rows[contribution.chosen[rows]],
                    contribution.kind,
                    group.plan.law, part.segments, particles_of(part.group),
                    self.layers[contribution.layer].sums,
                    self.memory.scratch[thread], dt, self._ghosts(part, thread, contribution.layer),
                )  # fmt: skip
            surface_fields.fill_at_surfaces(self, g, thread, rows, dt)

    def pack(self, part: FieldMessage) -> None:
        """Pack the sums of this rank into a section of a message."""
        bits = self.layers[part.layer].sums.view(np.uint64)
        reproducible_sums.pack(part.numbers, part.tails, part.blocks, part.masks, bits)

    def add(self, part: FieldMessage) -> None:
        """Add the sums of another rank."""
        layer = self.layers[part.layer]
        reproducible_sums.unpack(
            part.numbers, part.tails, part.blocks, part.masks, layer.sums, layer.bias,
            self.tables.phase,
        )  # fmt: skip

    def begin_impulses(self) -> NodeState:
        """Convert momentum and stress impulses to numbers, and return the nodes."""
        self.each(self._convert_momentum)
        return self.node_state()

    def _convert_momentum(self, thread: int) -> None:
        self.call_if_rows(
            (), update.convert_momentum, self.block_shares.all[thread], self.blocks,
            self.layers["momentum"].tables, self.layers["impulses"].tables,
            self.plan_tables.phases, self.step, self.memory.overflow[thread],
        )  # fmt: skip

    def update(self, border: bool) -> None:
        """Convert sums to velocities (gravity, couplings, contact, walls) and to mean values."""
        self.each(self._update, border)

    def _update(self, thread: int, border: bool) -> None:
        blocks = self.block_shares.stage(border)[thread]
        layers = self.layers
        phases = self.plan_tables.phases
        for feature in self.features.values():
            phases = feature.divide_phases(phases)
        if not self.dt:
            kind = None if self.correction is None else self.correction.nodes
            self.call_if_rows(
                (kind is None,), transfer_correction.momentum_to_velocity_only, blocks,
                self.blocks, layers["momentum"].tables, self.plan_tables.phase_sets, phases,
                kind, *self.timeless_field, self.step, self.memory.overflow[thread],
            )  # fmt: skip
            return
        separate = self.separated_stress(
            self.plan_tables.shared_stress, layers.stage, self.memory.stage_scratch[thread]
        )
        rigid, solids = self.plan_tables.boundaries, self.solids
        if solids is not None:
            rigid = rigid._replace(
                nodes=solids.nodes, moves=solids.moves, collider_number=solids.collider_number
            )
        if (marks := reserved_nodes(self.features)) is not None:
            rigid = rigid._replace(motions=rigid.motions._replace(reserved=marks))
        shear = layers["shear"].tables if self.plan.has_surface_friction else None
        summed = update.CommonFields(layers["momentum"].tables, layers["offsets"].tables)
        self.call_if_rows(
            (), update.update, blocks, self.blocks, summed, shear, separate, self.plan.pair_rules,
            self.plan_tables.walls, phases, rigid, self.memory.workspaces[thread], self.step,
            self.memory.overflow[thread],
        )  # fmt: skip
        for name, carried in self.layers.requests.carried.items():
            self.call_if_rows(
                (), carried_values.average_over_phases, blocks, self.blocks, layers[name].tables,
                carried.set_of, self.memory.overflow[thread], self.layers.numbers[name],
            )  # fmt: skip

    def gather(self, step: int) -> StepReport:
        """Transfer grid velocities to the particles and advect them."""
        real = self.plan.real.type
        motion = g2p.StepConstants(
            real(self.dt), real(self.plan.time_step.cfl), self.plan.time_step.max_cells,
            2.0 ** BITS[self.plan.real], *dither_of_step(step),
        )  # fmt: skip
        self.memory.reports[:] = 0
        self.each(self._gather, motion)
        rows = self.memory.reports.reshape(-1, MAXIMA)
        maxima = rows.max(0).tolist()
        failed = [
            (int(row[FAILED_ID]) - 1, int(row[FAILURE])) for row in rows[rows[:, FAILED_ID] > 0]
        ]
        stress = max(float(scratch.peak.max()) for scratch in self.memory.scratch)
        speed, gradient2 = self.plan.dx * maxima[SPEED], maxima[GRADIENT2]
        bounds = speed, math.sqrt(gradient2), math.sqrt(stress)
        return StepReport(maxima[RATE], maxima[STRAY], bounds, failed, self._found_beyond())

    def _gather(self, thread: int, motion: g2p.StepConstants) -> None:
        scratch = self.memory.scratch[thread]
        for g, (part, report) in enumerate(zip(self.parts, self.memory.reports, strict=True)):
            group, plan = part.group, part.group.plan
            rows = part.partition.all[thread]
            particles = particles_of(group)
            if plan.is_carried:
                self._carry(g, rows, motion, report[thread])
                continue
            for name, channel in part.carried:
                self.call_if_rows(
                    (g,), carried_values.gather_values, rows, channel, part.segments, particles,
                    self.layers[name].nodes, scratch,
                )  # fmt: skip
            auxiliary = auxiliary_gather_kind(self.plan, plan, self.layers.gathered_nodes, self.dt)
            self.call_if_rows(
                (g,), g2p.grid_to_particles, rows, plan.law, part.segments, particles,
                self.layers["momentum"].nodes, auxiliary, scratch, part.numbers, motion,
                report[thread], self._ghosts(part, thread),
            )  # fmt: skip
            if plan.tracks_deformation:
                row = plan.channels.first("F")
                self.call_if_rows(
                    (g,), g2p.update_total_deformation, rows, group.start,
                    group.count, group.f, row, motion.dt,
                )  # fmt: skip

    def _carry(self, g: int, rows: np.ndarray, motion: g2p.StepConstants, report) -> None:
        """Advect particles of group `g` with a given motion; particles at rest stay."""
        part, group = self.parts[g], self.groups[g]
        carrier: Any = carrier_of(self.features, group.plan.carrier) or self.driven
        row = -1 if carrier is None else carrier.row_of_group(g, group.plan.phase)
        if row >= 0:
            rotated = np.array([group.plan.channels.first(name) for name in ROTATED_CHANNELS])
            self.call_if_rows(
                (), advect_prescribed, rows, part.segments, group.block, particles_of(group), row,
                carrier.motions, rotated, self.plan.dx, self.dt, motion, report,
            )  # fmt: skip

    def correct_transfers(self, times: int) -> list[AccumulatorOverflow]:
        """Add `times` the motion that a step of no time has taken from the particles."""
        self.each(self._correct_transfers, self.plan.real.type(times))
        return self._found_beyond()

    def _correct_transfers(self, thread: int, times: float) -> None:
        dx = self.plan.real.type(self.plan.dx)
        for g, part in enumerate(self.parts):
            if part.group.plan.is_carried:
                continue
            kind = None if self.correction is None else self.correction.kind_of(g)
            self.call_if_rows(
                (kind is None,), transfer_correction.apply_transfer_correction,
                part.partition.all[thread], times, part.segments, particles_of(part.group),
                self.layers["momentum"].nodes, self.memory.scratch[thread], dx, kind,
                self._ghosts(part, thread),
            )  # fmt: skip
