"""GPU engine: tables and kernels of the CPU engine with GPU arrays and loops."""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.kernels.grid import update as grid
from vgmpi.kernels.kernel_arguments import (
    MAX_VOLUME_STRAIN_PER_STEP,
    Segments,
    Step,
)
from vgmpi.kernels.rigid.prescribed_motion import ROTATED_CHANNELS
from vgmpi.kernels.step_records import AccumulatorOverflow, StepReport, dither_of_step
from vgmpi.kernels.transfer import g2p
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.parallel.block_lattice import BITS
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.solver.engines.compiled_engine import CompiledEngine
from vgmpi.solver.engines.group_context import GroupContext, auxiliary_gather_kind

from . import gather_kernels, grid_kernels, scatter_kernels, thread_block, translation_types
from .device_group import CardGroup
from .device_memory import CardLayer, Copies, flattened, map_tuple, to_card, to_card_together
from .graphics_card import with_device_context
from .grid_kernels import NODES
from .kernel_launch import Launcher
from .particle_intrinsics import CARRIED, PARTICLE, STRAY, TURNING
from .scalar_math import constants, polynomials
from .step_record import FINE, RecordBuffer, StepRecord
from .translation import KernelTranslator
from .translation_types import SIMULATED

HALF = 16  # threads of a team that represents a SIMD vector
MOVED = ("xi", "f")


class Work(NamedTuple):
    """Tables of a group in GPU memory, and lists of its segments."""

    segments: Segments
    all: Any  # (n,) segments
    contributions: dict  # (contribution, border) -> (n,) segments


class Cuda(CompiledEngine):
    """Particles and nodes of one rank on a GPU; see solver/engines/engine_protocol.py."""

    GROUP, LAYER, LAUNCHER = CardGroup, CardLayer, Launcher

    def __init__(self, plan, lattice, solids, threads=1, driven=None):
        super().__init__(plan, lattice, solids, 1, driven)
        self.real = plan.real.type
        self.copies = Copies()
        self.step_number = 0  # number of the step, for error messages
        self.work: list[Work] = []
        phases = len(plan.phases)
        patches = 1 + len(self.layers.gathered_nodes)
        by_cells = any(group.volume.by_cells for group in plan.groups)
        sizes = {
            "WORDS": self.words, "PHASES": phases, "SPLINES": bool(plan.splines), "CELLS": by_cells,
            "PAIRS": phases * (phases + 1) // 2 + 3 * phases,
            "CONTACT_ENABLED": phases > 1 or solids is not None or bool(plan.planes),
            "PITCH": 16 if plan.splines or by_cells else 17,
            "BESIDE": patches * gather_kernels.PATCH + 16,
        }  # fmt: skip
        common = constants(plan.real) | polynomials(plan.real)
        common |= translation_types.constants(
            sizes, grid_kernels, scatter_kernels, gather_kernels, grid
        )
        teams = thread_block.HALVES[0]
        half_constants = common | {"TEAM": HALF, "TEAMS": teams}
        self.halves = self.LAUNCHER(KernelTranslator(plan.real, half_constants), HALF * teams)
        self.teams = teams
        threads = HALF if SIMULATED else 128
        block_constants = common | {"TEAM": threads, "TEAMS": 1}
        self.wholes = self.LAUNCHER(KernelTranslator(plan.real, block_constants), threads)
        self.buffer = RecordBuffer(self.real, len(self.layers))
        self.record = self.buffer.card
        for layer in self.layers.values():
            layer.reset = self._reset
        for group in self.groups:
            group.launcher = self.wholes

    def _reset(self, layer: CardLayer) -> None:
        self._half(
            NODES, grid_kernels.reset, len(layer.phase), layer.tables.sums,
            layer.device_bias, layer.device_phase,
        )  # fmt: skip

    def _half(self, mode, function, teams: int, *arguments) -> None:
        """Launch a kernel with one half warp for each of `teams` segments or blocks."""
        self.halves.launch(-(-teams // self.teams), mode, function, *arguments)

    # ---- after a sort ----------------------------------------------------------------------------

    @with_device_context
    def set_topology(self, tables: ExchangeTopology, unchanged: bool = False) -> None:
        """Allocate nodes and segment tables after a sort."""
        self._forget_arguments()
        for part in self.parts:
            self.copies.forget((part.segments.start, part.segments.count))
        super().set_topology(tables, unchanged)
        self.firsts: dict[int, Any] = {}
        if unchanged:
            self.work = [
                self._with_counts(part, work)
                for part, work in zip(self.parts, self.work, strict=True)
            ]
            return
        self.copies.clear()
        shares = [self.block_shares.stage(border)[0] for border in (False, True)]
        segments = [(*part.segments[:5], part.segments.mirror) for part in self.parts]
        constant = self.plan_tables.walls, self.plan_tables.phases, self.plan_tables.boundaries
        self.copies.add((self.blocks, *shares, *constant, *segments))
        self.todo = dict(zip((False, True), map(self.copies.on_device, shares), strict=True))
        self.on_card = self.copies.on_device(self.blocks)
        self.auxiliary = {
            name: flattened(self.copies.on_device(values))
            for name, values in self.layers.gathered_nodes.items()
        }
        self.stage_on_card = self.copies.on_device(self.layers.stage_at(self.auxiliary))
        self.rigid = self._rigid()
        self.work = [self._laid_out(part) for part in self.parts]

    def _with_counts(self, part: GroupContext, work: Work) -> Work:
        """Return the tables of a group with the present starts and counts of its segments."""
        host = part.segments
        self.copies.add((host.start, host.count))
        start, count = map(self.copies.on_device, (host.start, host.count))
        return work._replace(segments=work.segments._replace(start=start, count=count))

    def _forget_arguments(self) -> None:
        """Drop the stored arguments of launches, which keep the memory of their arrays."""
        self.halves.forget()
        self.wholes.forget()

    def _laid_out(self, part: GroupContext) -> Work:
        """Copy the tables of a group to the GPU."""
        copy = self.copies.on_device
        host = part.segments
        segments = Segments(
            copy(host.start), copy(host.count), copy(host.table), copy(host.accumulator_rows),
            copy(host.split),
            to_card(host.limit.astype(self.real)), copy(host.mirror),
        )  # fmt: skip
        lists = {}
        for border in (False, True):
            rows = part.partition.stage(border)[0]
            for k, contribution in enumerate((*part.contributions, *part.timeless)):
                lists[k, border] = rows[contribution.chosen[rows]]
        *on_card, every = to_card_together([*lists.values(), part.partition.all[0]])
        return Work(segments, every, dict(zip(lists, on_card, strict=True)))

    def open(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        super().open(wall)
        self._forget_arguments()
        self.copies.forget(self.plan_tables.walls)
        for part in self.parts:
            self.copies.forget(part.segments.mirror)
        self.work = [self._laid_out(part) for part in self.parts]

    # ---- a step ----------------------------------------------------------------------------------

    @with_device_context
    def begin(
        self, dt: float, gravity: np.ndarray, speed: float,
        correction: CorrectionKinds | None = None,
    ) -> None:  # fmt: skip
        """Choose the quanta of the sums of a step.

        Args:
            dt, gravity, speed, correction: See `Engine.begin`.
        """
        if correction is not None:
            particles = map_tuple(correction.particles, self.real)
            correction = correction._replace(particles=particles)
        super().begin(dt, gravity, speed, correction)
        self.buffer.begin(self.step.gravity_increment)
        self.step = Step(float(dt), float(self.plan.dx), self.record.gravity_increment)

    @with_device_context
    def fill(self, border: bool) -> None:
        """Scatter the contributions of the particles to the sums."""
        for part, work in zip(self.parts, self.work, strict=True):
            first = 0 if self.dt else len(part.contributions)
            contributed = part.contributions if self.dt else part.timeless
            for k, contribution in enumerate(contributed, first):
                if self._is_summed(contribution.layer):
                    self._fill_one(part, work, contribution, work.contributions[k, border])

    def _fill_one(self, part: GroupContext, work: Work, contribution, rows) -> None:
        group: Any = part.group
        layer: Any = self.layers[contribution.layer]
        ghosts = self._ghosts(part, 0, contribution.layer)
        self._half(
            PARTICLE, scatter_kernels.fill, len(rows), rows, contribution.kind, group.plan.law,
            work.segments, group.on_card(), layer.tables.sums, layer.device_bias, group.plan.phase,
            self.record.peaks, self.real(self.dt), scatter_kernels.added_along(contribution.kind),
            self.copies.on_device(ghosts),
        )  # fmt: skip

    @with_device_context
    def pack(self, part: FieldMessage) -> None:
        """Pack the sums of this rank into a section of a message."""
        numbers, tails = self.copies.on_device((part.numbers, part.tails))
        layer: Any = self.layers[part.layer]
        self._half(
            NODES, grid_kernels.pack, len(part.blocks), numbers, tails,
            *self.copies.on_device((part.blocks, part.masks)), self._first(part),
            layer.tables.sums,
        )  # fmt: skip
        numbers.copy_to_host(part.numbers)
        tails.copy_to_host(part.tails)

    def _first(self, part: FieldMessage):
        """Return the index of the first sums of each node block in a message."""
        if id(part.masks) not in self.firsts:
            count = self.words * np.bitwise_count(part.masks).astype(np.int64)
            self.firsts[id(part.masks)] = to_card(np.cumsum(count) - count)
        return self.firsts[id(part.masks)]

    @with_device_context
    def add(self, part: FieldMessage) -> None:
        """Add the sums of another rank."""
        layer: Any = self.layers[part.layer]
        self._half(
            NODES, grid_kernels.unpack, len(part.blocks), *self.copies.refreshed((part.numbers,
            part.tails)),
            *self.copies.on_device((part.blocks, part.masks)), self._first(part),
            layer.tables.sums, layer.device_bias, self.on_card.phase,
        )  # fmt: skip

    @with_device_context
    def update(self, border: bool) -> None:
        """Convert sums to velocities (gravity, couplings, contact, walls) and to mean values."""
        blocks, copy = self.todo[border], self.copies.of_table
        momentum = self.layers["momentum"].tables
        if not self.dt:
            self._half(
                NODES, grid_kernels.settle, len(blocks), blocks, self.on_card, momentum,
                copy(self.plan_tables.phase_sets), copy(self.plan_tables.phases),
                self._kind_at_nodes(), *self.timeless_field, self.step, self.record.overflow,
            )  # fmt: skip
            return
        separate = self.separated_stress(
            copy(self.plan_tables.shared_stress), self.stage_on_card, ()
        )
        kernel = grid_kernels.update if separate is None else grid_kernels.update_apart
        shear = self.layers["shear"].tables if self.plan.has_surface_friction else None
        summed = grid.CommonFields(momentum, self.layers["offsets"].tables)
        pairs = self.plan.pair_rules
        pairs = None if pairs is None else self.copies.on_device(pairs)
        reactions = None if self.reactions is None else copy(self.reactions.by_thread[0])
        self._half(
            NODES, kernel, len(blocks), blocks, self.on_card, summed, shear, separate, pairs,
            copy(self.plan_tables.walls), copy(self.plan_tables.phases),
            self._rigid() if self._moves else self.rigid, reactions, self.step,
            self.record.overflow,
        )  # fmt: skip
        for name, carried in self.layers.requests.carried.items():
            self._half(
                NODES, grid_kernels.blend, len(blocks), blocks, self.on_card,
                self.layers[name].tables, copy(carried.set_of), self.record.overflow,
                self.layers.numbers[name],
            )  # fmt: skip

    def _kind_at_nodes(self) -> Any:
        """Return the kind by which a feature takes part in a step of no time, in GPU memory."""
        kind = None if self.correction is None else self.correction.nodes
        moves = self.solids is not None and len(self.solids.moves) > 0
        return self.copies.refreshed(kind) if moves else self.copies.on_device(kind)

    def _rigid(self) -> grid.RigidBoundaries:
        """Return colliders and prescribed bodies in their current state."""
        rigid, solids = self.plan_tables.boundaries, self.solids
        if solids is not None:
            rigid = rigid._replace(
                nodes=solids.nodes, moves=solids.moves, collider_number=solids.collider_number
            )
        return self.copies.refreshed(rigid)

    @property
    def _moves(self) -> bool:
        """True if colliders or prescribed bodies move."""
        return self.driven is not None or (self.solids is not None and len(self.solids.moves) > 0)

    @with_device_context
    def gather(self, step: int) -> StepReport:
        """Transfer grid velocities to the particles and advect them."""
        self.step_number = step + 1
        motion = g2p.StepConstants(
            self.real(self.dt), self.real(self.plan.time_step.cfl), self.plan.time_step.max_cells,
            2.0 ** BITS[self.plan.real], *dither_of_step(step),
        )  # fmt: skip
        for part, work in zip(self.parts, self.work, strict=True):
            self._gather_one(part, work, motion)
        return self._report()

    def _gather_one(self, part: GroupContext, work: Work, motion: g2p.StepConstants) -> None:
        group: Any = part.group
        plan, copy = group.plan, self.copies.on_device
        count, real = len(work.all), self.real
        if plan.driven:
            assert self.driven is not None
            if plan.phase in self.driven.phases:
                rotated = np.array([plan.channels.first(name) for name in ROTATED_CHANNELS])
                self.wholes.launch(
                    count, PARTICLE, gather_kernels.advect_prescribed, work.all, work.segments,
                    copy(group.block), group.on_card(MOVED, flat=False), plan.phase,
                    self.copies.refreshed(self.driven.motions), to_card(rotated), self.plan.dx,
                    self.dt,
                    motion, self.record.prescribed_maxima, self.record.failure,
                )  # fmt: skip
            return
        for name, channel in part.carried:
            self.wholes.launch(
                count, PARTICLE, gather_kernels.take, work.all, channel, work.segments,
                group.on_card(MOVED), self.layers[name].tables.nodes,
            )  # fmt: skip
        auxiliary = auxiliary_gather_kind(self.plan, plan, self.auxiliary, self.dt)
        ghosts = copy(self._ghosts(part, 0))
        self.wholes.launch(
            count, PARTICLE, gather_kernels.g2p, work.all, group.plan.law, work.segments,
            group.on_card(MOVED), self.layers["momentum"].tables.nodes, auxiliary, part.numbers,
            g2p.StepConstants(*map(real, motion)), self.record.maxima, self.record.failure, ghosts,
        )  # fmt: skip
        if plan.tracks_deformation:
            self.wholes.launch(
                count, PARTICLE, gather_kernels.follow, work.all, work.segments,
                group.on_card(MOVED), plan.channels.first("F"), motion.dt,
            )  # fmt: skip

    def _report(self) -> StepReport:
        """Return the report of the step from the maxima of the kernels."""
        report = self.buffer.read()
        fastest, stray, fast, stretching, displacement, gradient2 = report.maxima
        prescribed, dt = report.prescribed_maxima, self.real(self.dt)
        dx, cfl = self.real(self.plan.dx), self.real(self.plan.time_step.cfl)
        rate = max(
            float(fastest / (cfl * dx)), float(fast) / (self.plan.time_step.max_cells * float(dx)),
            float(stretching) / MAX_VOLUME_STRAIN_PER_STEP,
        )  # fmt: skip
        failure, failed = int(report.failure[0]), []
        if failure < FINE:
            failed = [divmod(failure, 8)]
        speed = self.plan.dx * max(float(displacement / dt) if dt else 0.0, prescribed[CARRIED])
        stress = float(report.peaks[0])
        bounds = speed, math.sqrt(max(float(gradient2), prescribed[TURNING])), math.sqrt(stress)
        return StepReport(
            rate, max(float(stray), prescribed[STRAY]), bounds, failed, self._overflows(report)
        )

    @with_device_context
    def correct_transfers(self, times: int) -> list[AccumulatorOverflow]:
        """Add `times` the motion that a step of no time has taken from the particles."""
        for g, (part, work) in enumerate(zip(self.parts, self.work, strict=True)):
            group: Any = part.group
            if not group.plan.driven:
                self.wholes.launch(
                    len(work.all), PARTICLE, gather_kernels.give_back, work.all, self.real(times),
                    work.segments, group.on_card(MOVED),
                    self.layers["momentum"].tables.nodes, self.real(self.plan.dx),
                    None if self.correction is None else self.correction.kind_of(g),
                    self.copies.on_device(self._ghosts(part, 0)),
                )  # fmt: skip
        return self._overflows(self.buffer.read())

    def _overflows(self, report: StepRecord) -> list[AccumulatorOverflow]:
        """Return the sums that left their range in the present step."""
        if (report.overflow == FINE).all():
            return []
        self.memory.overflow[0] = np.where(report.overflow == FINE, 0, report.overflow)
        return self._found_beyond()

    @with_device_context
    def take_reactions(self) -> np.ndarray:
        """Return the reactions summed since the last call, shape (rows, 7) int64."""
        assert self.reactions is not None
        sums = self.reactions.by_thread[0].sums
        self.copies.on_device(sums).copy_to_host(sums)
        total = self.reactions.take()
        self.copies.on_device(sums).copy_to_device(sums)
        return total
