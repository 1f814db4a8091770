"""The engine of a card: the processor's tables and kernels, with arrays and loops of the card's."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...device.limits import FARTHEST, STRETCH
from ...domain.blocks import BITS
from ...domain.driven import TURNED
from ...domain.halo import Part
from ...domain.topology import Topology, hue
from ...kernels import g2p, grid, sums
from ...kernels.tables import Segments, Step
from ..base import DITHER, Beyond, Report
from ..cpu import Cpu
from ..work import GroupWork, gathers
from . import nodes, team, transfer, words
from .card import named
from .group import CardGroup
from .launch import Launcher
from .memory import CardLayer, Copies, card_room, flattened, to_card
from .nodes import NODES
from .numbers import constants, polynomials
from .particle import PARTICLE
from .program import Program
from .words import SIMULATED

HALF = 16  # threads of a team that stands for a vector
MOVED = ("xi", "f")
FINE = (1 << 62) - 1  # no particle is wrong, no sum beyond its range


class Work(NamedTuple):
    """A group's tables in the card's memory, and lists of segments."""

    segments: Segments
    all: Any  # (n,) segments
    given: dict  # {(contribution, border): (n,) segments}


class Cuda(Cpu):
    """One rank's particles and nodes on a card. See engines/base.py."""

    GROUP, LAYER, LAUNCHER = CardGroup, CardLayer, Launcher

    def __init__(self, plan, lattice, solids, threads=1, driven=None):
        super().__init__(plan, lattice, solids, 1, driven)
        self.real = plan.real.type
        self.copies = Copies()
        self.at = 0  # step, for what is said of a card that fails
        self.work: list[Work] = []
        phases = len(plan.phases)
        patches = 1 + sum(self.gathered.values())
        sizes = {
            "WORDS": self.words, "PHASES": phases, "SPLINES": bool(plan.splines),
            "PAIRS": phases * (phases + 1) // 2 + 3 * phases,
            "TOUCHES": phases > 1 or solids is not None or bool(plan.planes),
            "PITCH": 16 if plan.splines else 17, "BESIDE": patches * transfer.PATCH + 16,
        }  # fmt: skip
        common = constants(plan.real) | polynomials(plan.real)
        common |= words.constants(sizes, nodes, transfer, grid)
        teams = team.HALVES[0]
        half = common | {"TEAM": HALF, "TEAMS": teams}
        self.halves = self.LAUNCHER(Program(plan.real, half), HALF * teams)
        self.teams = teams
        threads = HALF if SIMULATED else 128
        whole = common | {"TEAM": threads, "TEAMS": 1}
        self.wholes = self.LAUNCHER(Program(plan.real, whole), threads)
        self.found = to_card(np.zeros(6, self.real))
        self.most, self.worst = to_card(np.zeros(6)), to_card(np.full(1, FINE))
        self.peaks = to_card(np.zeros(1, self.real))
        self.past = to_card(np.full(len(self.layers), FINE))
        for layer in self.layers.values():
            layer.reset = self._reset
        for group in self.groups:
            group.launcher = self.wholes

    def _reset(self, layer: CardLayer) -> None:
        self._half(
            NODES, nodes.reset, len(layer.phase), layer.tables.sums,
            layer.of_rest, layer.of_phase,
        )  # fmt: skip

    def _half(self, mode, function, teams: int, *arguments) -> None:
        """Launch a kernel by half warps, one for each of so many segments or blocks."""
        self.halves.launch(-(-teams // self.teams), mode, function, *arguments)

    # ---- after a sort ----------------------------------------------------------------------------

    @staticmethod
    def room_for(values, rows: int):
        return card_room(values, rows, (sums.BLOCK,), values.dtype)

    @named
    def adopt(self, tables: Topology, kept: bool = False) -> None:
        """Lay out nodes and segments after a sort."""
        super().adopt(tables, kept)
        self.copies.clear()
        self.firsts: dict[int, Any] = {}
        if not kept:
            self.todo = {
                border: self.copies.of(self.block_shares.of(border)[0]) for border in (False, True)
            }
            self.on_card = self.copies.of(self.blocks)
        self.work = [self._laid_out(part) for part in self.parts]

    def _laid_out(self, part: GroupWork) -> Work:
        copy = self.copies.of
        of = part.segments
        segments = Segments(
            copy(of.start), copy(of.count), copy(of.table), copy(of.into), copy(of.split),
            to_card(of.limit.astype(self.real)), copy(of.mirror),
        )  # fmt: skip
        given = {}
        for border in (False, True):
            rows = part.shares.of(border)[0]
            for k, one in enumerate((*part.given, part.moving)):
                given[k, border] = to_card(rows[one.chosen[rows]])
        return Work(segments, to_card(part.shares.all[0]), given)

    def open(self, wall: int) -> None:
        """A wall has vanished."""
        super().open(wall)
        self.copies.forget(self.walls)
        for part in self.parts:
            self.copies.forget(part.segments.mirror)
        self.work = [self._laid_out(part) for part in self.parts]

    # ---- a step ----------------------------------------------------------------------------------

    @named
    def begin(self, dt: float, gravity: np.ndarray, speed: float) -> None:
        """Choose the quanta of the step's sums."""
        super().begin(dt, gravity, speed)
        self.peaks.copy_to_device(np.zeros(1, self.real))
        self.step = Step(float(dt), float(self.plan.dx), to_card(self.step.fall))

    @named
    def fill(self, border: bool) -> None:
        """Add what the particles contribute to the sums."""
        for part, work in zip(self.parts, self.work, strict=True):
            last = len(part.given)
            chosen = range(last) if self.dt else [last]
            for k in chosen:
                one = part.given[k] if k < last else part.moving
                self._fill_one(part, work, one, work.given[k, border])

    def _fill_one(self, part: GroupWork, work: Work, one, rows) -> None:
        group: Any = part.group
        layer: Any = self.layers[one.layer]
        ghosts = self._ghosts(part, 0, one.layer)
        self._half(
            PARTICLE, transfer.fill, len(rows), rows, one.kind, group.plan.law, work.segments,
            group.on_card(), layer.tables.sums, layer.of_rest, group.plan.phase,
            self.peaks, self.real(self.dt), hasattr(one.kind, "splines"), self.copies.of(ghosts),
        )  # fmt: skip

    @named
    def pack(self, part: Part) -> None:
        """Put this rank's sums into a part of a message."""
        numbers, tails = self.copies.of((part.numbers, part.tails))
        layer: Any = self.layers[part.layer]
        self._half(
            NODES, nodes.pack, len(part.blocks), numbers, tails,
            *self.copies.of((part.blocks, part.masks)), self._first(part),
            layer.tables.sums,
        )  # fmt: skip
        numbers.copy_to_host(part.numbers)
        tails.copy_to_host(part.tails)

    def _first(self, part: Part):
        """Number of the first sums of each node block in a message."""
        if id(part.masks) not in self.firsts:
            count = self.words * np.bitwise_count(part.masks).astype(np.int64)
            self.firsts[id(part.masks)] = to_card(np.cumsum(count) - count)
        return self.firsts[id(part.masks)]

    @named
    def add(self, part: Part) -> None:
        """Add another rank's sums."""
        layer: Any = self.layers[part.layer]
        self._half(
            NODES, nodes.unpack, len(part.blocks), *self.copies.new((part.numbers, part.tails)),
            *self.copies.of((part.blocks, part.masks)), self._first(part),
            layer.tables.sums, layer.of_rest, self.on_card.phase,
        )  # fmt: skip

    @named
    def update(self, border: bool) -> None:
        """Turn sums into velocities: gravity, couplings, contact, walls; and into mean colours."""
        blocks, copy = self.todo[border], self.copies.of
        momentum = self.layers["momentum"].tables
        if not self.dt:
            self._half(
                NODES, nodes.settle, len(blocks), blocks, self.on_card, momentum,
                copy(self.as_one), copy(self.phases), self.step, self.past,
            )  # fmt: skip
            return
        apart, kernel = None, nodes.update
        if self.apart:
            kernel = nodes.update_apart
            apart = grid.Apart(
                self.layers["impulses"].tables, **{k: v for k, v in self._beside().items()},
                noted=int(self.gathered["change"]), room=(), tables=copy(self.pairs),
            )  # fmt: skip
        shear = self.layers["shear"].tables if self.plan.rubs else None
        summed = grid.Summed(momentum, self.layers["offsets"].tables)
        rules = None if self.plan.rules is None else copy(self.plan.rules)
        given = None if self.givers is None else copy(self.givers.of_thread[0])
        self._half(
            NODES, kernel, len(blocks), blocks, self.on_card, summed, shear, apart, rules,
            copy(self.walls), copy(self.phases), self._rigid(), given, self.step, self.past,
        )  # fmt: skip
        for k, layer in enumerate(self.hues):
            self._half(
                NODES, nodes.blend, len(blocks), blocks, self.on_card, layer.tables,
                copy(self.sets), self.past, len(self.layers) - len(self.hues) + k,
            )  # fmt: skip

    def _beside(self) -> dict:
        """What is gathered beside velocity, as the card has it."""
        return {name: flattened(self.copies.of(one)) for name, one in self.beside.items()}

    def _rigid(self) -> grid.Rigid:
        """Colliders and what is driven, as they are now."""
        rigid, solids = self.none, self.solids
        if solids is not None:
            rigid = rigid._replace(nodes=solids.nodes, moves=solids.moves, whose=solids.whose)
        moves = self.driven is not None or (solids is not None and len(solids.moves) > 0)
        return self.copies.new(rigid) if moves else self.copies.of(rigid)

    @named
    def gather(self, step: int) -> Report:
        """Move the particles by the velocities at the nodes."""
        self.at = step + 1
        motion = g2p.Motion(
            self.real(self.dt), self.real(self.plan.cfl), 2.0 ** BITS[self.plan.real],
            *(d * step % 1.0 for d in DITHER),
        )  # fmt: skip
        self.found.copy_to_device(np.zeros(6, self.real))
        self.most.copy_to_device(np.zeros(6))
        self.worst.copy_to_device(np.full(1, FINE))
        for part, work in zip(self.parts, self.work, strict=True):
            self._gather_one(part, work, motion)
        return self._report()

    def _gather_one(self, part: GroupWork, work: Work, motion: g2p.Motion) -> None:
        group: Any = part.group
        plan, copy = group.plan, self.copies.of
        count, real = len(work.all), self.real
        if plan.driven:
            assert self.driven is not None
            if plan.phase in self.driven.phases:
                turned = np.array([plan.channels.first(name) for name in TURNED])
                self.wholes.launch(
                    count, PARTICLE, transfer.carried, work.all, work.segments, copy(group.block),
                    group.on_card(MOVED, flat=False), plan.phase, self.copies.new(self.driven.ways),
                    to_card(turned), self.plan.dx, self.dt, motion, self.most, self.worst,
                )  # fmt: skip
            return
        first = plan.channels.first("colour")
        for k in range(plan.coefficients):
            self.wholes.launch(
                count, PARTICLE, transfer.take, work.all, first + 3 * k, work.segments,
                group.on_card(MOVED), self.layers[hue(k)].tables.nodes,
            )  # fmt: skip
        beside = gathers(self.plan, plan, self._beside(), self.dt)
        ghosts = copy(self._ghosts(part, 0))
        self.wholes.launch(
            count, PARTICLE, transfer.g2p, work.all, group.plan.law, work.segments,
            group.on_card(MOVED), self.layers["momentum"].tables.nodes, beside, part.numbers,
            g2p.Motion(*map(real, motion)), self.found, self.worst, ghosts,
        )  # fmt: skip
        if plan.followed:
            self.wholes.launch(
                count, PARTICLE, transfer.follow, work.all, work.segments,
                group.on_card(MOVED), plan.channels.first("F"), motion.dt,
            )  # fmt: skip

    def _report(self) -> Report:
        """What the kernels have found, as engines/base.py wants it."""
        fastest, far, quick, stretching, carried, turning = self.found.copy_to_host()
        most, dt = self.most.copy_to_host(), self.real(self.dt)
        dx, cfl = self.real(self.plan.dx), self.real(self.plan.cfl)
        rate = max(
            float(fastest / (cfl * dx)), float(quick) / (FARTHEST * float(dx)),
            float(stretching) / STRETCH,
        )  # fmt: skip
        worst, wrong = int(self.worst.copy_to_host()[0]), []
        if worst < FINE:
            wrong = [divmod(worst, 8)]
        speed = self.plan.dx * max(float(carried / dt) if dt else 0.0, most[4])
        stress = float(self.peaks.copy_to_host()[0])
        reach = speed, math.sqrt(max(float(turning), most[5])), math.sqrt(stress)
        return Report(rate, max(float(far), most[1]), reach, wrong, self._found_beyond())

    @named
    def restore(self, times: int) -> list[Beyond]:
        """Give the particles `times` what a step of no time has taken from their motion."""
        for part, work in zip(self.parts, self.work, strict=True):
            group: Any = part.group
            if not group.plan.driven:
                self.wholes.launch(
                    len(work.all), PARTICLE, transfer.give_back, work.all, self.real(times),
                    work.segments, group.on_card(MOVED),
                    self.layers["momentum"].tables.nodes, self.real(self.plan.dx),
                    self.copies.of(self._ghosts(part, 0)),
                )  # fmt: skip
        return self._found_beyond()

    def _found_beyond(self) -> list[Beyond]:
        past = self.past.copy_to_host()
        if (past == FINE).all():
            return []
        self.past.copy_to_device(np.full(len(self.layers), FINE))
        self.beyond[0] = np.where(past == FINE, 0, past)
        return super()._found_beyond()

    @named
    def given(self) -> np.ndarray:
        """What rigid things gave."""
        assert self.givers is not None
        own = self.givers.of_thread[0].sums
        self.copies.of(own).copy_to_host(own)
        found = self.givers.taken()
        self.copies.of(own).copy_to_device(own)
        return found
