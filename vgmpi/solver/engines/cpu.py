"""CPU engine: arrays and kernel calls of a time step, in compiled code on the processor's cores."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, carrier_of, reserved_nodes
from vgmpi.kernels import particle_records, reproducible_sums
from vgmpi.kernels.grid import contact_impulses, mixture_workspace, update
from vgmpi.kernels.kernel_arguments import NodeBlocks, Step, Sums
from vgmpi.kernels.nodal_fields import carried_values
from vgmpi.kernels.reaction_impulses import GhostNodes
from vgmpi.kernels.rigid.prescribed_motion import (
    NO_PRESCRIBED_BODIES,
    ROTATED_CHANNELS,
    PrescribedBodies,
)
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
)
from vgmpi.kernels.transfer import g2p, p2g, transfer_correction
from vgmpi.kernels.transfer.particle_shifting import NodeFill, ShiftConstants
from vgmpi.kernels.wall_boundary import KINDS, patch_codes
from vgmpi.parallel.block_lattice import BITS, BlockLattice
from vgmpi.parallel.exchange_topology import REST_VOLUME, ExchangeTopology
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.runtime.aligned_arrays import aligned_zeros, with_capacity

from . import surface_fields
from .engine_protocol import DITHER, CollidersAtNodes
from .group_context import (
    GroupContext,
    auxiliary_gather_kind,
    group_context,
    lowest_overflow,
    particles_of,
)
from .kernel_caller import KernelCaller
from .nodal_field_storage import FieldRequests, NodalField, nodal_fields
from .plan_tables import phase_sets, phase_table, wall_kinds_of, wall_table
from .reaction_sums import ReactionAccumulators
from .shift_tables import node_fill, with_colliders
from .thread_partition import ThreadPartition, accumulator_copies


class Cpu(KernelCaller):
    """Particles and nodes of one rank on `threads` threads; see solver/engines/engine_protocol.py.

    Threads add to the same nodes. Where two of them would do so at the same time, all but the first
    add to copies, which are merged before the sums are read. This changes no bit of the sums.
    """

    GROUP, LAYER = ParticleGroup, NodalField  # array classes, replaced by other engines

    def __init__(
        self, plan: Plan, lattice: BlockLattice, solids: CollidersAtNodes | None,
        threads: int = 1,
        driven: PrescribedBodies | None = None,
    ):  # fmt: skip
        super().__init__(threads)
        self.plan, self.driven = plan, driven
        self.features: Mapping[str, ActiveFeature] = {}  # of the run, set by the simulation
        self.groups = [self.GROUP(group, lattice, plan.real) for group in plan.groups]
        self.solids = solids
        self.no_rigid = update.RigidBoundaries(
            np.zeros((0, 64, 4), plan.real), np.zeros((0, 64, 3), plan.real),
            np.zeros((0, 64), int), NO_PRESCRIBED_BODIES if driven is None else driven.motions,
            getattr(solids, "is_free", np.zeros(0, bool)),
        )  # fmt: skip
        self.walls, self.phases = wall_table(plan), phase_table(plan)
        self.separates_stress = any(group.separates_stress for group in plan.groups)
        self.requests = FieldRequests(plan)
        fields = nodal_fields(self.requests, self.separates_stress, self.LAYER)
        self.layers = {field.name: field for field in fields}
        self.number_of_field = {name: k for k, name in enumerate(self.layers)}
        self.words = reproducible_sums.accumulator_words(plan.real)
        self.phase_sets = phase_sets(plan)
        # auxiliary nodal values that particles gather, by name
        has_change = plan.flip is not None
        self.gathered = {"flux": plan.rules is not None, "drift": plan.drifts, "change": has_change}
        self.gathered |= {name: True for each in plan.features for name in each.gathered}
        self.gathered_nodes = {
            name: aligned_zeros((0, reproducible_sums.BLOCK), plan.real) for name in self.gathered
        }
        self.fill_of_nodes = node_fill(plan)
        self.shift: ShiftConstants | None = None
        patch_count = max(sum(self.gathered.values()), int(plan.shift_interval > 0))
        patch_count = max(patch_count, surface_fields.patch_count(plan))
        self.scratch = [particle_records.scratch(plan.real, patch_count) for _ in range(threads)]
        self.workspaces = [
            contact_impulses.contact_workspace(len(plan.phases)) for _ in range(threads)
        ]
        self.mixture_workspace = [
            mixture_workspace.mixture_workspace(len(plan.phases), plan.real, aligned_zeros)
            for _ in range(threads if self.separates_stress else 0)
        ]
        self.reactions: ReactionAccumulators | None = None
        self.pairs = mixture_workspace.mixture_tables(plan.rules) if plan.rules is not None else ()
        self.parts: list[GroupContext] = []
        self.reports = np.zeros((len(plan.groups), threads, MAXIMA))
        self.overflow = np.zeros((threads, len(self.layers)), np.int64)

    def enable_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum the reactions of colliders and walls.

        Args:
            rows, quanta, rank: See `EngineServices.enable_reactions`.
        """
        self.reactions = ReactionAccumulators(self.plan, rows, quanta, rank, self.threads)

    def take_reactions(self) -> np.ndarray:
        """Return the reactions summed since the last call, shape (rows, 7) int64."""
        assert self.reactions is not None
        return self.reactions.take()

    # ---- after a sort ----------------------------------------------------------------------------

    def set_topology(self, tables: ExchangeTopology, unchanged: bool = False) -> None:
        """Allocate nodes and segment tables after a sort; unchanged tables keep sums and copies."""
        self.entries = {}
        rows = [np.flatnonzero(tables.group == g) for g in range(len(self.groups))]
        for group, group_rows in zip(self.groups, rows, strict=True):
            if not np.array_equal(tables.code[group_rows], group.code):
                raise RuntimeError(f"group {group.plan.name}: segments do not match the census")
        if unchanged:
            self.parts = [
                part._replace(segments=part.segments._replace(start=g.start, count=g.count))
                for part, g in zip(self.parts, self.groups, strict=True)
            ]
            return
        self.tables = tables
        partitions = [
            ThreadPartition(group.count, tables.border[group_rows], self.threads)
            for group, group_rows in zip(self.groups, rows, strict=True)
        ]
        target, copied, copy_rows = accumulator_copies(tables, rows, partitions, self.threads)
        self.blocks = NodeBlocks(
            tables.first,
            tables.phase,
            tables.coordinates,
            tables.may_touch,
            tables.solid,
            copied,
            copy_rows,
        )
        phase_of_row = np.concatenate([tables.phase, np.repeat(tables.phase, np.diff(copied))])
        for name, layer in self.layers.items():
            layer.set_topology(tables.has_terms[name], phase_of_row)
        for name, requested in self.gathered.items():
            if requested:
                self.gathered_nodes[name] = self.grown_nodes(
                    self.gathered_nodes[name], len(tables.phase)
                )
        self.block_shares = ThreadPartition(
            np.diff(tables.first), tables.receives_remote, self.threads
        )
        sent = [link.send_blocks for links in tables.shared.values() for link in links.values()]
        self.merged_rows = np.unique(np.concatenate([np.zeros(0, np.int64), *sent]))
        if self.reactions is not None:
            self.reactions.set_topology(tables)
            self.workspaces = self.reactions.attach_to_workspaces(self.workspaces)
        self.parts = []
        for group, own, partition in zip(self.groups, rows, partitions, strict=True):
            context = group_context(
                self.requests, group, tables, own, target[own], partition, self._mirror(group),
                self.reactions,
            )  # fmt: skip
            self.parts.append(context)
        surface_fields.restrict_offsets(self)

    @staticmethod
    def grown_nodes(values, rows: int):
        """Return an array of node blocks with room for `rows` blocks."""
        return with_capacity(values, rows)

    def open(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        for kinds in self.walls[1:4]:
            kinds[divmod(wall, 2)] = KINDS["open"]
        for part in self.parts:
            part.segments.mirror[:] = self._mirror(part.group)

    def _mirror(self, group: ParticleGroup) -> np.ndarray:
        """Return the codes of the walls that a group's segments meet."""
        kinds = wall_kinds_of(self.walls, self.plan.phases[group.plan.phase])
        return patch_codes(group.block, self.plan.cells, kinds)

    # ---- a step ----------------------------------------------------------------------------------

    def begin(
        self, dt: float, gravity: np.ndarray, speed: float, shift: ShiftConstants | None = None
    ) -> None:
        """Choose the quanta of the sums of a step.

        Args:
            dt, gravity, speed, shift: See `Engine.begin`.
        """
        self.dt, self.shift = dt, shift
        for scratch in self.scratch:
            scratch.peak[:] = 0.0
        velocity_step = np.zeros(4, self.plan.real)
        velocity_step[:3] = dt * gravity
        self.step = Step(dt, self.plan.dx, velocity_step)
        rounded_speed = reproducible_sums.quantize_speed(speed)
        for layer in self.layers.values():
            layer.begin(rounded_speed)
        self.flags = surface_fields.surface_flags(self)

    def fill(self, border: bool) -> None:
        """Scatter the contributions of the particles to the sums."""
        self.each(self._fill, border)
        if border and self.threads > 1:
            for name, layer in self.layers.items():
                if len(layer.phase) and self._is_summed(name):
                    reproducible_sums.merge_thread_copies(
                        self.merged_rows, self.blocks, layer.tables
                    )

    def _is_summed(self, name: str) -> bool:
        """Return whether particles contribute to a nodal field in the present step."""
        if name == "momentum":
            return True
        if name in self.requests.timeless:
            return self.shift is not None
        return bool(self.dt)

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
                            self.scratch[thread], dt, self._ghosts(part, thread, layer),
                        )  # fmt: skip
                continue
            for k, contribution in enumerate(part.contributions):
                self.call_if_rows(
                    (g, k), p2g.particles_to_grid, rows[contribution.chosen[rows]],
                    contribution.kind,
                    group.plan.law, part.segments, particles_of(part.group),
                    self.layers[contribution.layer].sums,
                    self.scratch[thread], dt, self._ghosts(part, thread, contribution.layer),
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

    def update(self, border: bool) -> None:
        """Convert sums to velocities (gravity, couplings, contact, walls) and to mean values."""
        self.each(self._update, border)

    def _update(self, thread: int, border: bool) -> None:
        blocks = self.block_shares.stage(border)[thread]
        layers, separate = self.layers, None
        phases = self.phases
        for feature in self.features.values():
            phases = feature.divide_phases(phases)
        if not self.dt:
            self.call_if_rows(
                (self.shift is None,), transfer_correction.momentum_to_velocity_only, blocks,
                self.blocks, layers["momentum"].tables, self.phase_sets, phases,
                self.node_fill_now(), *self.rest_volumes, self.step, self.overflow[thread],
            )  # fmt: skip
            return
        if self.separates_stress:
            separate = update.SeparatedStress(
                layers["impulses"].tables, **self.gathered_nodes,
                needs_change=int(self.gathered["change"]),
                workspace=self.mixture_workspace[thread], tables=self.pairs,
            )  # fmt: skip
        rigid, solids = self.no_rigid, self.solids
        if solids is not None:
            rigid = rigid._replace(
                nodes=solids.nodes, moves=solids.moves, collider_number=solids.collider_number
            )
        if (marks := reserved_nodes(self.features)) is not None:
            rigid = rigid._replace(motions=rigid.motions._replace(reserved=marks))
        shear = layers["shear"].tables if self.plan.has_surface_friction else None
        summed = update.CommonFields(layers["momentum"].tables, layers["offsets"].tables)
        self.call_if_rows(
            (), update.update, blocks, self.blocks, summed, shear, separate, self.plan.rules,
            self.walls, phases, rigid, self.workspaces[thread], self.step, self.overflow[thread],
        )  # fmt: skip
        for name, carried in self.requests.carried.items():
            self.call_if_rows(
                (), carried_values.average_over_phases, blocks, self.blocks, layers[name].tables,
                carried.set_of, self.overflow[thread], self.number_of_field[name],
            )  # fmt: skip

    def begin_coupling(self) -> NodeState:
        """Convert the sums that only couplings read to numbers, and return the nodes."""
        for number, (name, field) in enumerate(self.layers.items()):
            if name in self.requests.of_couplings:
                reproducible_sums.finalize_field(
                    self.blocks, field.tables, self.overflow[0], number
                )
        return NodeState(
            self.layers["momentum"].nodes, self.layers, self.gathered_nodes, self.tables,
            self.blocks,
            self.block_shares.all, self.phases, self.walls,
            [workspace.reactions for workspace in self.workspaces], self.each, self.call,
        )  # fmt: skip

    def end_coupling(self) -> None:
        """Do nothing: the nodes have their velocities."""

    def gather(self, step: int) -> StepReport:
        """Transfer grid velocities to the particles and advect them."""
        real = self.plan.real.type
        motion = g2p.StepConstants(
            real(self.dt), real(self.plan.cfl), 2.0 ** BITS[self.plan.real],
            *(d * step % 1.0 for d in DITHER),
        )  # fmt: skip
        self.reports[:] = 0
        self.each(self._gather, motion)
        rows = self.reports.reshape(-1, MAXIMA)
        maxima = rows.max(0).tolist()
        failed = [
            (int(row[FAILED_ID]) - 1, int(row[FAILURE])) for row in rows[rows[:, FAILED_ID] > 0]
        ]
        stress = max(float(scratch.peak.max()) for scratch in self.scratch)
        speed, gradient2 = self.plan.dx * maxima[SPEED], maxima[GRADIENT2]
        bounds = speed, math.sqrt(gradient2), math.sqrt(stress)
        return StepReport(maxima[RATE], maxima[STRAY], bounds, failed, self._found_beyond())

    def _gather(self, thread: int, motion: g2p.StepConstants) -> None:
        scratch = self.scratch[thread]
        for g, (part, report) in enumerate(zip(self.parts, self.reports, strict=True)):
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
            auxiliary = auxiliary_gather_kind(self.plan, plan, self.gathered_nodes, self.dt)
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

    def node_fill_now(self) -> NodeFill | None:
        """Return what fills the nodes' cells if the step of no time shifts particles."""
        return None if self.shift is None else with_colliders(self.fill_of_nodes, self.solids)

    @property
    def rest_volumes(self) -> tuple[Sums | None, int]:
        """Sums of rest volumes, if liquids of one phase differ in density, and their number."""
        if REST_VOLUME not in self.layers:
            return None, 0
        return self.layers[REST_VOLUME].tables, self.number_of_field[REST_VOLUME]

    def correct_transfers(self, times: int) -> list[AccumulatorOverflow]:
        """Add `times` the motion that a step of no time has taken from the particles."""
        self.each(self._correct_transfers, self.plan.real.type(times))
        return self._found_beyond()

    def _correct_transfers(self, thread: int, times: float) -> None:
        dx = self.plan.real.type(self.plan.dx)
        for part in self.parts:
            if part.group.plan.is_carried:
                continue
            shift = self.shift if part.group.plan.shifts else None
            self.call_if_rows(
                (shift is None,), transfer_correction.apply_transfer_correction,
                part.partition.all[thread], times, part.segments, particles_of(part.group),
                self.layers["momentum"].nodes, self.scratch[thread], dx, shift,
                self._ghosts(part, thread),
            )  # fmt: skip

    def _ghosts(
        self, part: GroupContext, thread: int, layer: str = "momentum"
    ) -> GhostNodes | None:
        """Return the ghost record of a transfer, None where reactions are not requested."""
        if self.reactions is None or part.ghosts is None or part.group.plan.is_carried:
            return None
        return self.reactions.ghosts_of_transfer(part.ghosts, thread, layer, self.dt)

    def _found_beyond(self) -> list[AccumulatorOverflow]:
        """Return the lowest node block of each field in which a sum left its range."""
        if not self.overflow.any():
            return []
        layers = enumerate(self.layers)
        overflows = [lowest_overflow(self.overflow[:, k], self.tables, name) for k, name in layers]
        self.overflow[:] = 0
        return [overflow for overflow in overflows if overflow is not None]
