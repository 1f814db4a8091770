"""How full liquids make their cells: the fullest cell, and the volume that all of them fill.

A node's cell cannot hold more than its volume. Where particles crowd, it holds more: so much of the
liquid's volume is lost to the eye. Both numbers follow from the rest volumes of the particles at
the nodes, which are summed as integers: they do not depend on the number of ranks.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.diagnostics import CELL_UNITS, deposit_rest_volume
from vgmpi.parallel.exchange_topology import counting_owner
from vgmpi.planning.plan import Plan
from vgmpi.solver.simulation import Simulation

MAX_CELLS = 1 << 20  # largest fullness [cells] that is told
# [-] of a liquid's volume, lost by crowding or gained by voids, from which a run names it
NAMED_CHANGE = 0.02
# [-] fullness from which a node's cell counts as part of the liquid, and as all of it: a surface in
# between counts by as much too little on one side as too much on the other
EMPTY, FULL = 0.15, 0.85


class LiquidFill(NamedTuple):
    """Fill of the cells by the liquids of a phase."""

    fullest_cell: float  # [-] largest rest volume in a node's cell, over the cell's volume
    filled_volume: float  # [m3] of its rest volume, what fits into the cells that it is in
    occupied_volume: float  # [m3] of the cells that it takes, with voids
    rest_volume: float  # [m3]


def liquid_phases(plan: Plan) -> list[int]:
    """Return the phases that hold liquids alone, and share space with no others."""
    liquid = {g.phase for g in plan.groups if g.is_liquid and not g.shares_space}
    return sorted(liquid - {g.phase for g in plan.groups if not g.is_liquid or g.shares_space})


def liquid_fill(simulation: Simulation) -> dict[int, LiquidFill]:
    """Return how full the liquids make their cells, by phase; on every rank. Collective."""
    plan, phases = simulation.plan, liquid_phases(simulation.plan)
    if not phases:
        return {}
    tables, ranks = simulation.exchange.tables, simulation.ranks
    sums = np.zeros((len(tables.phase), 64), np.int64)
    for g, group in enumerate(simulation.groups):
        if group.plan.phase in phases:
            deposit_rest_volume(
                group.start, group.count, group.block, tables.table[tables.group == g], group.xi,
                group.f, group.bits, plan.dx, np.array(plan.cells), sums,
            )  # fmt: skip
    add_remote_sums(simulation, sums)
    of_liquid = np.isin(tables.phase, phases)
    total = np.zeros((len(tables.coordinates), 64), np.int64)
    block = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))
    np.add.at(total, block[of_liquid], sums[of_liquid])
    capacity = cell_capacity(plan, tables.coordinates)
    with np.errstate(divide="ignore", invalid="ignore"):
        fullness = np.where(capacity > 0, total / capacity, 0.0)
    fits = 1.0 / np.maximum(fullness, 1.0)
    part = np.clip((fullness - EMPTY) / (FULL - EMPTY), 0.0, 1.0)
    occupied_share = part / np.maximum(fullness, EMPTY)
    own = counting_owner(tables, ranks.rank).astype(bool)
    rows = []
    for p in phases:
        mine = tables.phase == p
        volume, where = np.where(own[block[mine]], sums[mine], 0), block[mine]
        fullest = np.where(volume > 0, fullness[where], 0.0).max(initial=0.0)
        filled = np.floor(volume * fits[where]).astype(np.int64).sum()
        occupied = np.floor(volume * occupied_share[where]).astype(np.int64).sum()
        units = int(np.rint(min(fullest, MAX_CELLS) * CELL_UNITS))
        rows.append((units, int(filled), int(occupied), int(volume.sum())))
    every = ranks.all_rows(np.array(rows, np.int64)[None])
    return {
        p: LiquidFill(
            float(every[:, k, 0].max() / CELL_UNITS),
            *(float(every[:, k, c].sum() / CELL_UNITS * plan.dx**3) for c in (1, 2, 3)),
        )
        for k, p in enumerate(phases)
    }


def changed_volume_lines(entries: list[dict]) -> list[str]:
    """Return a line for each phase whose liquids lost volume by crowding, or gained it by voids.

    Args:
        entries: Entries of `conservation_rows`.
    """
    lines = []
    for entry in entries:
        names = ("rest_volume", "filled_volume", "occupied_volume")
        volume, filled, occupied = (entry.get(name, 0.0) for name in names)
        if volume > 0.0 and occupied > (1.0 + NAMED_CHANGE) * volume:
            lines.append(
                f"  volume     {entry['phase']} takes {100 * occupied / volume:.1f} % of its"
                " volume: there are voids in it, or froth"
            )
        if volume > 0.0 and filled < (1.0 - NAMED_CHANGE) * volume:
            lines.append(
                f"  volume     {entry['phase']} fills {100 * filled / volume:.1f} % of its volume:"
                f" its particles crowd, a cell holds up to {entry['fullest_cell']:.2f} times what"
                " fits into it"
            )
    return lines


def add_remote_sums(simulation: Simulation, sums: np.ndarray, to_all: bool = False) -> None:
    """Add the sums of higher ranks to those of the nodes that this rank counts. Collective.

    Args:
        simulation: The simulation.
        sums: Sums of the node blocks (in/out), shape (node blocks, 64).
        to_all: Add the sums of all ranks, at all nodes that this rank's particles reach.
    """
    tables, ranks = simulation.exchange.tables, simulation.ranks
    block = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))
    place = np.column_stack([tables.coordinates[block], tables.phase])
    rows, to = [np.zeros((0, 68), np.int64)], [np.zeros(0, np.int64)]
    for other, fields in tables.shared.items():
        if (to_all or other < ranks.rank) and "momentum" in fields:
            sent = fields["momentum"]
            bits = sent.send_masks[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
            values = np.where(bits != 0, sums[sent.send_blocks], 0)
            rows.append(np.column_stack([place[sent.send_blocks], values]))
            to.append(np.full(len(values), other))
    received = ranks.sparse_exchange(np.concatenate(rows), np.concatenate(to))
    if not len(received):
        return
    index = {tuple(key): nb for nb, key in enumerate(place.tolist())}
    for row in received:
        sums[index[tuple(row[:4].tolist())]] += row[4:]


def cell_capacity(plan: Plan, blocks: np.ndarray) -> np.ndarray:
    """Return the part of each node's cell inside the domain in units, shape (n, 64).

    Args:
        plan: Plan of the run.
        blocks: Coordinates of the blocks, shape (n, 3).
    """
    corner = np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1)
    node = 4 * blocks[:, None] - 1 + corner
    cells = np.array(plan.cells)
    share = np.where((node == 0) | (node == cells), 0.5, 1.0)
    return np.where((node >= 0) & (node <= cells), share, 0.0).prod(-1) * CELL_UNITS
