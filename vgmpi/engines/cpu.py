"""The arrays and calls of a step on the processor's cores: one place that knows the kernels'
arguments.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..device.memory import aligned, grown
from ..domain.blocks import BITS, EDGE
from ..domain.state import Group
from ..domain.topology import Topology
from ..kernels import colour, g2p, gradient, grid, members, p2g, records
from ..kernels.patches import zero
from ..kernels.walls import KINDS, SIDE, patch_codes
from ..planning.plan import Plan

# generators of a sequence that fills the unit cube evenly (Roberts 2018): the dither of a step, the
# same on every rank
_DITHER = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])


RELAX = 10.0  # [1/s] at which a fluid in pores gives way where there is more volume than space


class Part(NamedTuple):
    """What the kernels are told of a group's segments; rows are segments."""

    group: Group
    sent: np.ndarray  # (n,) whether other ranks need the patch
    slots: np.ndarray  # (3, n) where its patches are kept, or -1; whether it has offsets, impulses
    hues: np.ndarray  # (layers, n) where its patches of colours are kept, or -1
    table: np.ndarray  # (n, 27) node blocks around
    into: np.ndarray  # (n, 27) those of them the patch is added to at once, else -1
    limit: np.ndarray  # (n, 3, 2) range of positions [cells]
    mirror: np.ndarray  # (n, 3, 2) wall codes
    numbers: records.Numbers


class Cpu:
    """Transfers and grid update of one rank's particles, by `threads` threads.

    The sum of a node block runs over its patches by (group, key). Where one thread has all of
    them, it adds each at once while it is in the first level cache; the patches of other node
    blocks, those near another rank or thread, are kept and summed by `update`. Threads share
    nothing they write, and both ways add in the same order: neither touches the bits.
    """

    def __init__(self, plan: Plan, solids, threads: int = 1):
        self.plan = plan
        self.threads = threads
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        real = plan.real
        self.bits = BITS[real]
        self.solid_nodes = np.zeros((0, 64, 4), real) if solids is None else solids.nodes
        self.wall_kinds = np.array([KINDS[kind] for kind, _ in plan.walls], np.int64).reshape(3, 2)
        self.wall_friction = np.array([mu for _, mu in plan.walls]).reshape(3, 2)
        self.gravity = np.array(plan.gravity)
        self.least = np.array([phase.least for phase in plan.phases])
        self.mastery = np.array([phase.mastery for phase in plan.phases])
        self.friction = np.array(plan.friction)
        self.cells = np.array(plan.cells)
        self.patches = aligned((0, SIDE, SIDE, SIDE, 4), real)
        self.grid = aligned((0, 64, 4), real)
        # only where phases, or a phase and a collider, may touch
        self.offsets, self.offsets_grid = self.patches, self.grid
        # only where phases share space, or for FLIP
        self.apart = any(group.apart for group in plan.groups)
        self.forces = self.patches if self.apart else None  # patches of impulses
        self.forces_grid = self.flux = self.grid if self.apart else None
        self.drift = self.grid if plan.drifts else None
        self.flip = real.type(plan.flip) if plan.flip else None
        layers = max((group.coefficients for group in plan.groups), default=0)
        self.colours = [colour.Layer(real) for _ in range(layers)]
        more = self.apart + plan.drifts  # patches besides velocity's that particles gather from
        room = records.ROOM + more * (records.PATCH + 16)
        self.records = [aligned(room, real) for _ in range(threads)]
        self.base = [np.zeros(records.BATCH + 22, np.int32) for _ in range(threads)]
        self.room = [grid.room(len(plan.phases), real) for _ in range(threads)]
        self.apart_room = [
            members.room(len(plan.phases), real, aligned)
            for _ in range(threads if self.apart else 0)
        ]
        self.tables = members.tables(plan.rules) if plan.rules is not None else ()
        self.reports = np.zeros((len(plan.groups), threads, 4))

    def adopt(self, groups: list[Group], topology: Topology, group_of_row: np.ndarray) -> None:
        """Lay out patches, node blocks and tables after a sort. group_of_row: (census rows,)."""
        t = self.topology = topology
        own = np.flatnonzero(t.own)
        group_of = group_of_row[t.row[own]]
        rows_of = [np.flatnonzero(group_of == g) for g in range(len(groups))]
        sent = np.zeros(len(t.row), bool)
        for _, patches, _, _ in t.sends:
            sent[patches] = True
        self.shares = [
            _Shares(group.count, sent[own[here]], self.threads, whole=True)
            for group, here in zip(groups, rows_of, strict=True)
        ]
        self.block_shares = _Shares(np.diff(t.first), t.waits, self.threads)
        into = self._who_sums([own[here] for here in rows_of], sent)
        self._make_room()
        self.parts = []
        slots = np.stack([self.slot, np.where(t.offsets, 0, -1), np.where(t.split, 0, -1)])
        coefficients = np.array([group.plan.coefficients for group in groups])
        for k, layer in enumerate(self.colours):
            layer.adopt(t, (self.slot >= 0) & (coefficients[group_of_row[t.row]] > k))
        for group, here in zip(groups, rows_of, strict=True):
            at = own[here]
            block = t.block[at]
            if not np.array_equal(block, group.block):
                raise RuntimeError(f"group {group.plan.name}: segments do not match the census")
            mirror = patch_codes(block, self.plan.cells, self.wall_kinds)
            self.parts.append(
                Part(
                    group, sent[at], np.ascontiguousarray(slots[:, at]),
                    np.array([layer.slot[at] for layer in self.colours]), t.table[here], into[here],
                    self._limits(block), mirror, self._numbers(group.plan),
                )
            )  # fmt: skip

    def _who_sums(self, patches_of: list[np.ndarray], sent: np.ndarray) -> np.ndarray:
        """Find the node blocks whose patches one thread fills, in order: `summed` and `clears`; and
        which patches must be kept: `slot`. Returns `into` of all own patches.

        patches_of: the own patches of each group; sent: (patches,).
        """
        t = self.topology
        filler = np.full(len(t.row), -1)  # thread that adds it; -1 for patches of other ranks
        for patches, shares in zip(patches_of, self.shares, strict=True):
            for thread, rows in enumerate(shares.inner):
                filler[patches[rows]] = thread
        by, into = filled_by_one(t, filler)
        self.summed = by >= 0
        self.clears = [np.flatnonzero(by == k) for k in range(self.threads)]
        self.clears_offsets = [np.flatnonzero((by == k) & t.asked) for k in range(self.threads)]
        self.clears_forces = [np.flatnonzero((by == k) & t.forced) for k in range(self.threads)]
        kept = ~t.own | sent
        kept[t.own] |= (into < 0).any(1)
        self.slot = np.where(kept, np.cumsum(kept) - 1, -1)
        return into

    def _make_room(self) -> None:
        """Patches, offsets and nodes of the size these tables ask for."""
        t = self.topology
        self.patches = grown(self.patches, int((self.slot >= 0).sum()))
        self.grid = grown(self.grid, len(t.phase))
        self.flat_patches = self.patches.reshape(len(self.patches), records.PATCH)
        self.flat_grid = self.grid.reshape(len(self.grid), 256)
        if self.apart:
            self.flux = grown(self.flux, len(t.phase))
            if self.drift is not None:
                self.drift = grown(self.drift, len(t.phase))
            self.forces = grown(self.forces, len(self.patches))
            self.forces = self.forces.reshape(len(self.forces), records.PATCH)
            self.forces[self.slot[~t.own]] = 0
            self.force_slot = np.where(t.split, self.slot, -1)
            self.forces_grid = grown(self.forces_grid, len(t.phase))
            self.forces_grid = self.forces_grid.reshape(len(self.forces_grid), 256)
            self.forces_grid[:] = 0
        touches = t.asked.any()
        self.offsets = grown(self.offsets, len(self.patches) if touches else 0)
        self.flat_offsets = self.offsets.reshape(len(self.offsets), records.PATCH)
        self.offset_slot = np.where(t.offsets, self.slot, -1)
        self.offsets_grid = grown(self.offsets_grid, len(t.phase) if touches else 0)
        self.flat_offsets_grid = self.offsets_grid.reshape(len(self.offsets_grid), 256)
        self.offsets_grid[:] = 0
        # boxes of ghost patches that do not arrive stay zero
        self.patches[self.slot[~t.own]] = 0
        if touches:
            self.offsets[self.slot[~t.own]] = 0

    @property
    def slots(self) -> list[np.ndarray]:
        """Where the patches of each layer that travels are kept: (patches,) each."""
        forces = [self.force_slot] if self.apart else []
        return [self.slot, self.offset_slot, *forces, *(layer.slot for layer in self.colours)]

    @property
    def layers(self) -> list[np.ndarray]:
        """The patches of each layer that travels, (slots, 2048) each."""
        forces = [self.forces] if self.apart else []
        hues = (layer.patches for layer in self.colours)
        return [self.flat_patches, self.flat_offsets, *forces, *hues]

    def _numbers(self, group) -> records.Numbers:
        """What the transfers are told of a group."""
        real = self.plan.real.type
        return records.Numbers(
            density=real(group.density),
            share=real(group.share),
            affine=real(self.plan.affine),
            splines=real(self.plan.splines),
            stiff=real(group.stiff),
            dense=real(group.dense),
            relax=real(RELAX),
            counted=real(self.plan.rules is not None),
            porosity=real(records.STATE + len(group.rest) if group.porous else -1),
            dx=real(self.plan.dx),
        )

    def _limits(self, block: np.ndarray) -> np.ndarray:
        """Range of positions [cells from the block's middle] whose base node exists, half a cell
        beyond the walls: (n, 3, 2)."""
        low = -2.0 - EDGE * block
        high = np.array(self.plan.cells) - 1.0 - EDGE * block
        return np.stack([np.maximum(low, -5.0), np.minimum(high, 5.0)], -1)

    def p2g(self, dt: float, border: bool) -> None:
        """Fill the patches of this rank's segments: those that other ranks need, or the others."""
        real = self.plan.real.type
        if not border:
            self.each(self.clears, self._clear, self.flat_grid)
            self.each(self.clears_offsets, self._clear, self.flat_offsets_grid)
            if self.apart:
                self.each(self.clears_forces, self._clear, self.forces_grid)
            for layer in self.colours:
                self.each(self.clears, self._clear, layer.grid)
        for part, shares in zip(self.parts, self.shares, strict=True):
            self.each(shares.of(border), self._p2g, part, border, real(dt))
            for k in range(part.group.plan.coefficients):
                self.each(shares.of(border), self._collect, part, border, k)

    def _clear(self, thread: int, rows: np.ndarray, grid: np.ndarray) -> None:
        zero(grid, rows)

    def _p2g(self, thread: int, share: np.ndarray, part: "Part", border: bool, dt) -> None:
        group = part.group
        p2g.p2g(
            group.plan.law, share, border, part.sent, group.start, group.count, part.slots,
            part.into, part.mirror, group.xi, group.f, self.flat_patches,
            (self.flat_offsets, self.flat_offsets_grid),
            (self.forces, self.forces_grid) if group.plan.apart else None, self.flat_grid,
            self.records[thread], self.base[thread], part.numbers, dt,
        )  # fmt: skip

    def _collect(self, thread: int, share: np.ndarray, part: "Part", border: bool, k: int) -> None:
        group, layer = part.group, self.colours[k]
        colour.collect(
            group.plan.law, share, border, part.sent, group.start, group.count, part.hues[k],
            part.into, group.xi, group.f, group.plan.colour + 3 * k, layer.patches, layer.grid,
            self.records[thread], self.base[thread],
        )  # fmt: skip

    def update(self, dt: float, border: bool) -> None:
        """Sum the patches, and find the velocities at the nodes: gravity, contact, walls. Blocks
        whose sum takes patches of other ranks, or the others."""
        self.each(self.block_shares.of(border), self._update, dt)
        for layer in self.colours:
            self.each(self.block_shares.of(border), self._blend, layer)

    def _update(self, thread: int, share: np.ndarray, dt: float) -> None:
        t = self.topology
        apart = None
        if self.apart:
            apart = grid.Apart(
                self.force_slot,
                self.forces,
                self.forces_grid,
                t.forced,
                self.flux,
                self.flux if self.drift is None else self.drift,
                self.apart_room[thread],
                self.tables,
            )
        grid.update(
            share, t.first, t.phase, t.block_at, t.meets, t.solid_of,
            self.summed, t.pull_first, t.pull_patch, t.pull_code, self.slot, self.flat_patches,
            self.offset_slot, self.flat_offsets, self.offsets_grid, apart, self.plan.rules,
            self.grid, self.solid_nodes, self.room[thread], self.cells, self.wall_kinds,
            self.wall_friction, self.gravity, self.least, self.mastery, self.friction, dt,
            self.plan.dx,
        )  # fmt: skip

    def _blend(self, thread: int, share: np.ndarray, layer: colour.Layer) -> None:
        t = self.topology
        colour.blend(
            share, t.first, t.phase, self.plan.colours.set_of, self.summed, t.pull_first,
            t.pull_patch, t.pull_code, layer.slot, layer.patches, layer.grid,
        )  # fmt: skip

    def g2p(self, dt: float, step: int) -> np.ndarray:
        """Move the particles. Returns (groups, threads, 4) reports, see g2p.g2p."""
        dither = np.modf(_DITHER * step)[0]
        reports = self.reports
        reports[:] = 0
        for part, shares, report in zip(self.parts, self.shares, reports, strict=True):
            self.each(shares.all, self._g2p, part, self.plan.real.type(dt), dither, report)
        return reports

    def _g2p(self, thread: int, share: np.ndarray, part: "Part", dt, dither, report) -> None:
        group = part.group
        for k in range(group.plan.coefficients):
            colour.take(
                share, group.start, group.count, part.table, group.xi, group.f,
                group.plan.colour + 3 * k, self.colours[k].grid, self.records[thread],
                self.base[thread],
            )  # fmt: skip
        second = group.plan.apart
        g2p.g2p(
            group.plan.law, share, group.start, group.count, part.table, part.limit, part.mirror,
            group.xi, group.f, group.ids, self.grid, self.flux if second else None,
            self.drift if second else None,
            self.flip if second else None, part.slots[2], self.records[thread], self.base[thread],
            part.numbers, self.bits, dither, dt, self.plan.real.type(self.plan.cfl), report[thread],
        )  # fmt: skip
        if group.plan.followed:
            first = group.plan.gradient
            gradient.follow(share, group.start, group.count, group.f, first, dt)

    def each(self, shares: list[np.ndarray], work, *arguments) -> None:
        """work(thread, share, *arguments) for every share that is not empty."""
        if self.pool is None:
            if len(shares[0]):
                work(0, shares[0], *arguments)
            return
        waiting = [self.pool.submit(work, k, s, *arguments) for k, s in enumerate(shares) if len(s)]
        for w in waiting:
            w.result()


def filled_by_one(t: Topology, filler: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which thread fills all patches of each node block, or -1: (node blocks,); and the node blocks
    around each own patch where it is one and the same, else -1: (own patches, 27).

    filler: (patches,) thread, -1 for patches of other ranks.
    """
    if not len(t.phase):
        return t.phase, t.table
    fillers, first = filler[t.pull_patch], t.pull_first[:-1]
    lowest = np.minimum.reduceat(fillers, first)
    by = np.where(lowest == np.maximum.reduceat(fillers, first), lowest, -1)
    return by, np.where(by[t.table] >= 0, t.table, -1)


class _Shares:
    """What each thread does: of all rows, of those at the border to other ranks, and after these:
    of the others, or of all once more (whole), where those of the border are nearly done."""

    def __init__(self, weights: np.ndarray, border: np.ndarray, threads: int, whole: bool = False):
        row = np.arange(len(weights))
        self.all = _shares(row, weights, threads)
        self.border = _shares(row[border], weights[border], threads)
        rest = row if whole else row[~border]
        self.inner = _shares(rest, np.where(border, 0, weights)[rest], threads)

    def of(self, border: bool) -> list[np.ndarray]:
        return self.border if border else self.inner


def _shares(rows: np.ndarray, weights: np.ndarray, threads: int) -> list[np.ndarray]:
    """Consecutive rows of about equal weight, one array per thread."""
    ends = np.cumsum(weights)
    total = ends[-1] if len(ends) else 0
    cut = np.searchsorted(ends, total * np.arange(1, threads) / threads)
    return np.split(rows, cut)
