"""Compiled code on the processor's cores: the arrays and calls of a step."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..device.calls import entry
from ..device.memory import aligned, grown
from ..domain.blocks import BITS, EDGE, Lattice
from ..domain.driven import NOTHING, TURNED, Driven
from ..domain.halo import Part
from ..domain.movers import Movers
from ..domain.solids import Solids
from ..domain.state import Group
from ..domain.topology import Topology, hue
from ..kernels import g2p, gradient, grid, members, p2g, records, restore, sums, touch
from ..kernels.driven import carry
from ..kernels.given import Ghosts
from ..kernels.layers import colour, momentum
from ..kernels.tables import NodeBlocks, Phases, Segments, Step, Walls
from ..kernels.walls import KINDS, patch_codes
from ..planning.plan import Plan
from .base import DITHER, Beyond, Report
from .given import Givers
from .layers import Contribution, Layer, contributions, hues, layers
from .shares import Shares, copies
from .work import GroupWork, gathers, lowest_beyond, numbers_of, particles_of


class Cpu:
    """One rank's particles and nodes on `threads` threads. See engines/base.py.

    Threads add to the same nodes: where two of them would at the same time, all but the first add
    to copies, which are united before anyone reads the sums. That touches no bit of them.
    """

    GROUP, LAYER = Group, Layer  # where arrays lie: an engine may have them elsewhere

    def __init__(
        self, plan: Plan, lattice: Lattice, solids: Solids | Movers | None, threads: int = 1,
        driven: Driven | None = None,
    ):  # fmt: skip
        self.driven = driven
        self.plan, self.threads = plan, threads
        self.groups = [self.GROUP(group, lattice, plan.real) for group in plan.groups]
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self.solids = solids
        self.none = grid.Rigid(
            np.zeros((0, 64, 4), plan.real), np.zeros((0, 64, 3), plan.real),
            np.zeros((0, 64), int), NOTHING if driven is None else driven.ways,
        )  # fmt: skip
        kinds = np.array([KINDS[kind] for kind, _ in plan.walls], np.int64).reshape(3, 2)
        friction = np.array([mu for _, mu in plan.walls]).reshape(3, 2)
        met = kinds.copy()
        for plane in plan.planes:
            met[plane.axis, plane.side] = 0
        self.walls = Walls(np.array(plan.cells), kinds, met, friction)
        self.phases = Phases(
            np.array([phase.least for phase in plan.phases]),
            np.array([phase.mastery for phase in plan.phases]),
            np.array(plan.friction),
            np.array(plan.stiff),
            np.array([phase.surface for phase in plan.phases]),
        )
        self.apart = any(group.apart for group in plan.groups)
        self.layers = {layer.name: layer for layer in layers(plan, self.apart, self.LAYER)}
        self.hues = [self.layers[hue(k)] for k in range(hues(plan))]
        self.words = sums.words(plan.real)
        self.sets = np.zeros(0, np.int64) if plan.colours is None else plan.colours.set_of
        alone = np.full(len(plan.phases), -1)
        self.as_one = alone if plan.rules is None else plan.rules.as_one
        # what particles gather besides, where something asks for it
        kept = plan.keeps is not None
        self.gathered = {"flux": plan.rules is not None, "drift": plan.drifts, "change": kept}
        self.beside = {name: aligned((0, sums.BLOCK), plan.real) for name in self.gathered}
        more = sum(self.gathered.values())
        self.scratch = [records.scratch(plan.real, more) for _ in range(threads)]
        self.room = [touch.room(len(plan.phases)) for _ in range(threads)]
        self.apart_room = [
            members.room(len(plan.phases), plan.real, aligned)
            for _ in range(threads if self.apart else 0)
        ]
        self.givers: Givers | None = None
        self.pairs = members.tables(plan.rules) if plan.rules is not None else ()
        self.parts: list[GroupWork] = []
        self.reports = np.zeros((len(plan.groups), threads, 6))
        self.beyond = np.zeros((threads, len(self.layers)), np.int64)
        self.entries: dict[tuple, Callable] = {}  # compiled code for the arrays in force

    def feel(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Sum what is rigid gives, from now on."""
        self.givers = Givers(self.plan, rows, quanta, rank, self.threads)

    def given(self) -> np.ndarray:
        """What it has given since this was asked."""
        assert self.givers is not None
        return self.givers.taken()

    # ---- after a sort ----------------------------------------------------------------------------

    def adopt(self, tables: Topology, kept: bool = False) -> None:
        """Lay out nodes and segments after a sort. Where the tables are those of before, sums and
        copies stay."""
        self.entries = {}
        rows = [np.flatnonzero(tables.group == g) for g in range(len(self.groups))]
        for group, here in zip(self.groups, rows, strict=True):
            if not np.array_equal(tables.code[here], group.code):
                raise RuntimeError(f"group {group.plan.name}: segments do not match the census")
        if kept:
            self.parts = [
                part._replace(
                    particles=particles_of(g),
                    segments=part.segments._replace(start=g.start, count=g.count),
                )
                for part, g in zip(self.parts, self.groups, strict=True)
            ]
            return
        self.tables = tables
        shares = [
            Shares(group.count, tables.border[here], self.threads)
            for group, here in zip(self.groups, rows, strict=True)
        ]
        into, copied, copy_rows = copies(tables, rows, shares, self.threads)
        self.blocks = NodeBlocks(
            tables.first, tables.phase, tables.at, tables.meets, tables.solid, copied, copy_rows
        )
        phase_of_row = np.concatenate([tables.phase, np.repeat(tables.phase, np.diff(copied))])
        for name, layer in self.layers.items():
            layer.adopt(tables.asked[name], phase_of_row)
        for name, asked in self.gathered.items():
            if asked:
                self.beside[name] = self.room_for(self.beside[name], len(tables.phase))
        self.block_shares = Shares(np.diff(tables.first), tables.waits, self.threads)
        sent = [one.send_blocks for found in tables.shared.values() for one in found.values()]
        self.united = np.unique(np.concatenate([np.zeros(0, np.int64), *sent]))
        if self.givers is not None:
            self.givers.adopt(tables)
            self.room = self.givers.rooms(self.room)
        self.parts = [
            self._work(g, here, into[here], share)
            for g, (here, share) in enumerate(zip(rows, shares, strict=True))
        ]

    @staticmethod
    def room_for(values, rows: int):
        """An array of node blocks with room for that many."""
        return grown(values, rows)

    def _work(self, g: int, rows: np.ndarray, into: np.ndarray, shares: Shares) -> GroupWork:
        """What the transfers of a group need. rows: its segments in the tables."""
        group, tables = self.groups[g], self.tables
        split = tables.takes["impulses"][rows] if self.apart else np.zeros(len(rows), bool)
        segments = Segments(
            group.start, group.count, tables.table[rows], into, split, self._limits(group.block),
            self._mirror(group),
        )  # fmt: skip
        takes = {name: found[rows] for name, found in tables.takes.items()}
        given = contributions(self.plan, group.plan, takes, split)
        moving = Contribution("momentum", momentum.kinds(self.plan, group.plan)[1], split | True)
        numbers, ghosts = numbers_of(self.plan, group.plan), None
        if self.givers is not None:
            ghosts = self.givers.ghosts(group.block, segments.mirror)
        return GroupWork(
            group, particles_of(group), segments, shares, given, moving, numbers, ghosts
        )  # fmt: skip

    def _limits(self, block: np.ndarray) -> np.ndarray:
        """Range of positions [cells from the block's middle] whose base node exists, half a cell
        beyond the walls: (n, 3, 2)."""
        low = -2.0 - EDGE * block
        high = np.array(self.plan.cells) - 1.0 - EDGE * block
        return np.stack([np.maximum(low, -5.0), np.minimum(high, 5.0)], -1)

    def open(self, wall: int) -> None:
        """A wall has vanished."""
        for kinds in (self.walls.kinds, self.walls.met):
            kinds[divmod(wall, 2)] = KINDS["open"]
        for part in self.parts:
            part.segments.mirror[:] = self._mirror(part.group)

    def _mirror(self, group: Group) -> np.ndarray:
        """Codes of the walls that a group's segments meet."""
        kinds = self.walls.met if group.plan.surface else self.walls.kinds
        return patch_codes(group.block, self.plan.cells, kinds)

    # ---- a step ----------------------------------------------------------------------------------

    def begin(self, dt: float, gravity: np.ndarray, speed: float) -> None:
        """Choose the quanta of the step's sums."""
        self.dt = dt
        for scratch in self.scratch:
            scratch.peak[:] = 0.0
        fall = np.zeros(4, self.plan.real)
        fall[:3] = dt * gravity
        self.step = Step(dt, self.plan.dx, fall)
        coarse = sums.coarse(speed)
        for layer in self.layers.values():
            layer.begin(coarse)

    def fill(self, border: bool) -> None:
        """Add what the particles contribute to the sums."""
        self.each(self._fill, border)
        if border and self.threads > 1:
            for layer in self.layers.values() if self.dt else [self.layers["momentum"]]:
                if len(layer.phase):
                    sums.merge(self.united, self.blocks, layer.tables)

    def _fill(self, thread: int, border: bool) -> None:
        dt = self.plan.real.type(self.dt)
        for g, part in enumerate(self.parts):
            group = part.group
            rows = part.shares.of(border)[thread]
            if not self.dt:
                if group.plan.driven:  # and loses nothing by transfers
                    continue
                self.call(
                    ("still",), p2g.fill, rows, part.moving.kind, None, part.segments,
                    part.particles, self.layers["momentum"].sums, self.scratch[thread], dt,
                    self._ghosts(part, thread),
                )  # fmt: skip
                continue
            for k, given in enumerate(part.given):
                self.call(
                    (g, k), p2g.fill, rows[given.chosen[rows]], given.kind, group.plan.law,
                    part.segments, part.particles, self.layers[given.layer].sums,
                    self.scratch[thread], dt, self._ghosts(part, thread, given.layer),
                )  # fmt: skip

    def pack(self, part: Part) -> None:
        """Put this rank's sums into a part of a message."""
        bits = self.layers[part.layer].sums.view(np.uint64)
        sums.pack(part.numbers, part.tails, part.blocks, part.masks, bits)

    def add(self, part: Part) -> None:
        """Add another rank's sums."""
        layer = self.layers[part.layer]
        sums.unpack(
            part.numbers, part.tails, part.blocks, part.masks, layer.sums, layer.rest,
            self.tables.phase,
        )  # fmt: skip

    def update(self, border: bool) -> None:
        """Turn sums into velocities: gravity, couplings, contact, walls; and into mean colours."""
        self.each(self._update, border)

    def _update(self, thread: int, border: bool) -> None:
        blocks = self.block_shares.of(border)[thread]
        layers, apart = self.layers, None
        if not self.dt:
            self.call(
                (), restore.settle, blocks, self.blocks, layers["momentum"].tables, self.as_one,
                self.phases, self.step, self.beyond[thread],
            )  # fmt: skip
            return
        if self.apart:
            apart = grid.Apart(
                layers["impulses"].tables, **self.beside, noted=int(self.gathered["change"]),
                room=self.apart_room[thread], tables=self.pairs,
            )  # fmt: skip
        rigid, solids = self.none, self.solids
        if solids is not None:
            rigid = rigid._replace(nodes=solids.nodes, moves=solids.moves, whose=solids.whose)
        shear = layers["shear"].tables if self.plan.rubs else None
        summed = grid.Summed(layers["momentum"].tables, layers["offsets"].tables)
        self.call(
            (), grid.update, blocks, self.blocks, summed, shear, apart, self.plan.rules,
            self.walls, self.phases, rigid, self.room[thread], self.step,
            self.beyond[thread],
        )  # fmt: skip
        for k, layer in enumerate(self.hues):
            self.call(
                (), colour.blend, blocks, self.blocks, layer.tables, self.sets,
                self.beyond[thread], len(layers) - len(self.hues) + k,
            )  # fmt: skip

    def gather(self, step: int) -> Report:
        """Move the particles by the velocities at the nodes."""
        real = self.plan.real.type
        motion = g2p.Motion(
            real(self.dt), real(self.plan.cfl), 2.0 ** BITS[self.plan.real],
            *(d * step % 1.0 for d in DITHER),
        )  # fmt: skip
        self.reports[:] = 0
        self.each(self._gather, motion)
        rows = self.reports.reshape(-1, 6)
        worst = rows.max(0).tolist()
        wrong = []
        if worst[2] > 0:
            wrong = [(int(row[2]) - 1, int(row[3])) for row in rows if row[2] > 0]
        stress = max(float(scratch.peak.max()) for scratch in self.scratch)
        reach = self.plan.dx * worst[4], math.sqrt(worst[5]), math.sqrt(stress)
        return Report(worst[0], worst[1], reach, wrong, self._found_beyond())

    def _gather(self, thread: int, motion: g2p.Motion) -> None:
        scratch = self.scratch[thread]
        for g, (part, report) in enumerate(zip(self.parts, self.reports, strict=True)):
            group, plan = part.group, part.group.plan
            rows = part.shares.all[thread]
            particles = part.particles
            if plan.driven:
                self._carry(part, rows, motion, report[thread])
                continue
            first = plan.channels.first("colour")
            for k in range(plan.coefficients):
                nodes = self.layers[hue(k)].nodes
                self.call(
                    (g,), colour.take, rows, first + 3 * k, part.segments, particles, nodes,
                    scratch,
                )  # fmt: skip
            beside = gathers(self.plan, plan, self.beside, self.dt)
            self.call(
                (g,), g2p.g2p, rows, plan.law, part.segments, particles,
                self.layers["momentum"].nodes, beside, scratch, part.numbers, motion,
                report[thread], self._ghosts(part, thread),
            )  # fmt: skip
            if plan.followed:
                at = plan.channels.first("F")
                self.call(
                    (g,), gradient.follow, rows, group.start, group.count, group.f, at, motion.dt
                )

    def _carry(self, part: GroupWork, rows: np.ndarray, motion: g2p.Motion, report) -> None:
        """Move what is driven; what is held stays."""
        group, driven = part.group, self.driven
        assert driven is not None
        if group.plan.phase in driven.phases:
            turned = np.array([group.plan.channels.first(name) for name in TURNED])
            self.call(
                (), carry, rows, part.segments, group.block, part.particles, group.plan.phase,
                driven.ways, turned, self.plan.dx, self.dt, motion, report,
            )  # fmt: skip

    def restore(self, times: int) -> list[Beyond]:
        """Give the particles `times` what a step of no time has taken from their motion."""
        self.each(self._restore, self.plan.real.type(times))
        return self._found_beyond()

    def _restore(self, thread: int, times: float) -> None:
        dx = self.plan.real.type(self.plan.dx)
        for part in self.parts:
            if part.group.plan.driven:
                continue
            self.call(
                (), restore.give_back, part.shares.all[thread], times, part.segments,
                part.particles, self.layers["momentum"].nodes, self.scratch[thread], dx,
                self._ghosts(part, thread),
            )  # fmt: skip

    def _ghosts(self, part: GroupWork, thread: int, layer: str = "momentum") -> Ghosts | None:
        """What a thread's transfers tell of walls, None where nobody asks or the layer has none."""
        if self.givers is None or part.ghosts is None or part.group.plan.driven:
            return None
        return self.givers.of(part.ghosts, thread, layer, self.dt)

    def _found_beyond(self) -> list[Beyond]:
        """The lowest node block of each layer of which a sum left its range."""
        if not self.beyond.any():
            return []
        layers = enumerate(self.layers)
        found = [lowest_beyond(self.beyond[:, k], self.tables, name) for k, name in layers]
        self.beyond[:] = 0
        return [one for one in found if one is not None]

    def call(self, of: tuple, kernel, rows: np.ndarray, *arguments) -> None:
        """kernel(rows, *arguments) where there are rows. of: what tells a kernel's calls apart
        whose arguments are of other types."""
        if len(rows):
            self.run(of, kernel, rows, *arguments)

    def run(self, of: tuple, kernel, *arguments) -> None:
        """kernel(*arguments); until the next sort, all calls of one kind take the same types."""
        compiled = self.entries.get((kernel, of))
        if compiled is None:
            compiled = self.entries[kernel, of] = entry(kernel, *arguments)
        compiled(*arguments)

    def each(self, work, *arguments) -> None:
        """work(thread, *arguments) on every thread."""
        if self.pool is None:
            work(0, *arguments)
            return
        waiting = [self.pool.submit(work, k, *arguments) for k in range(self.threads)]
        for w in waiting:
            w.result()
