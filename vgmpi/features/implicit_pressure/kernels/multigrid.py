"""Multigrid: transfers between a level and one of cells twice as long, and a cycle over levels.

A block of a coarse level covers two blocks of the finer one along each axis, so that its cells are
2 x 2 x 2 cells of that, and its nodes every second node. A coarse cell has pressure if one of
its cells has. The response of a coarse node is the mean over the 27 nodes around it, so that all
levels have the stencil of the finest. Interpolation is linear and mirrored at walls; restriction is
its transpose. Sums over the finest level, which ranks share, are whole numbers: their order
does not matter.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.vector16 import load, pointer, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import kernel

from .cell_stencils import mean_of_axes
from .relaxation import begin_sweeps, find_remainder, respond, sweep

WET, AXES, NODES = 0, 1, 4  # sums of a coarse block: cells with pressure, responses, nodes
# The largest response of a node that counts in the mean over nodes, relative to that of a full cell
# of the lightest liquid, and the quanta of that response.
MAX_RESPONSE, RESPONSE_QUANTA = 64.0, 2.0**30
# A coarse cell is twice as long: eight cells have a quarter of the second difference each.
COARSE_RESPONSE = 2.0


class WetRows(NamedTuple):
    """Blocks of the coarse levels with cells with pressure, and those of the nodes around them."""

    cells: np.ndarray
    first_cell: np.ndarray  # (levels + 1,) first of each level
    nodes: np.ndarray
    first_node: np.ndarray  # (levels + 1,)


@kernel
def count_responses(rows, counted, limit, quanta, level):
    """Store the responses of the nodes of some blocks in quanta, in place of u.

    Args:
        rows: Blocks, shape (n,).
        counted: 1 for nodes that this rank counts, else 0, flat.
        limit: Largest response that counts.
        quanta: Quanta per unit of a response, a power of two.
        level: LevelFields (in/out).
    """
    inverse, counts, u = pointer(level.inverse), pointer(counted), pointer(level.u)
    for b in rows:
        for a in range(3):
            for c in range(0, 64, 16):
                n = 192 * b + 64 * a + c
                response = load(inverse, n)
                counts_as = np.minimum(response, 0.0 * response + limit) * quanta
                store(u, n, np.floor(counts_as + 0.5) * load(counts, 64 * b + c))


@kernel
def sum_responses(rows, children, finer, counted, sums):
    """Sum responses and cells with pressure of the finer level for some coarse blocks.

    Args:
        rows: Coarse blocks with cells with pressure near by, shape (n,).
        children: See CoarseBlocks.
        finer: LevelFields of the finer level, see `count_responses`.
        counted: 1 for cells of the finer level that this rank counts, else 0, flat.
        sums: Whole numbers by coarse block, 0 before, shape (m, 5, 64) (in/out).
    """
    nodes, partial, column = np.empty((4, 9, 9, 9)), np.empty((4, 4, 9, 9)), np.empty((4, 4, 4, 9))
    cells = np.empty((9, 9, 9))
    for b in rows:
        for x in range(9):  # from one before the block
            for y in range(9):
                line = 64 * b + 16 * ((x + 3) // 4) + 4 * ((y + 3) // 4)
                column_of_cells = 16 * ((x + 3) % 4) + 4 * ((y + 3) % 4)
                for n in range(3):
                    block = children[line + n]
                    for k in range(0 if n else 3, 4):
                        c, z = 64 * block + column_of_cells + k, 4 * n + k - 3
                        u = 192 * block + column_of_cells + k
                        cells[x, y, z] = counted[c] if finer.scale[c] > 0 else 0.0
                        total = 0.0
                        for a in range(3):
                            nodes[a, x, y, z] = finer.u[u + 64 * a]
                            total += finer.u[u + 64 * a]
                        nodes[3, x, y, z] = 1.0 if total > 0.0 else 0.0
        for i in range(4):
            for a in range(4):
                part, full = partial[a, i], nodes[a]
                for y in range(9):
                    for z in range(9):
                        part[y, z] = (full[2 * i, y, z] + full[2 * i + 2, y, z]) + (
                            2.0 * full[2 * i + 1, y, z]
                        )
        for i in range(4):
            for j in range(4):
                for a in range(4):
                    line, part = column[a, i, j], partial[a, i]
                    for z in range(9):
                        line[z] = (part[2 * j, z] + part[2 * j + 2, z]) + 2.0 * part[2 * j + 1, z]
                for k in range(4):
                    q = 16 * i + 4 * j + k
                    for a in range(4):
                        line = column[a, i, j]
                        total = (line[2 * k] + line[2 * k + 2]) + 2.0 * line[2 * k + 1]
                        sums[b, AXES + a, q] = total
                    for p in range(8):
                        x, y, z = 2 * i + 1 + p // 4, 2 * j + 1 + p // 2 % 2, 2 * k + 1 + p % 2
                        sums[b, WET, q] += cells[x, y, z]


@kernel
def set_responses(rows, block, size, closed, quanta, sums, level):
    """Set the responses of coarse nodes, and mark the cells with pressure by a scale of 1.

    Args:
        rows: Coarse blocks, shape (n,).
        block: Coordinates of the blocks, shape (m, 3).
        size: Cells of the level along each axis, shape (3,).
        closed: Whether walls hold their nodes across, shape (3, 2).
        quanta: See `count_responses`.
        sums: See `sum_responses`.
        level: LevelFields of the coarse levels (out).
    """
    real = level.scale.dtype.type
    for b in rows:
        for q in range(64):
            node = 4 * block[b, 0] + q // 16, 4 * block[b, 1] + q // 4 % 4, 4 * block[b, 2] + q % 4
            level.scale[64 * b + q] = real(sums[b, WET, q] > 0)
            level.correction[64 * b + q] = level.remainder[64 * b + q] = real(0)
            total = max(sums[b, NODES, q], 1.0) * quanta
            for a in range(3):
                is_low, is_high = node[a] <= 0, node[a] >= size[a]  # on a wall or beyond it
                is_held = (is_low and closed[a, 0]) or (is_high and closed[a, 1])
                mean = 0.0 if is_held else COARSE_RESPONSE * sums[b, AXES + a, q] / total
                level.inverse[192 * b + 64 * a + q] = real(mean)


@kernel
def set_diagonal(rows, lattice, level):
    """Set the inverse diagonal of the cells that are marked by a scale of 1."""
    high, inverse, scale = pointer(lattice.high), pointer(level.inverse), pointer(level.scale)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            share = 0.5 * mean_of_axes(inverse, high, b, x)
            zero = 0.0 * share
            is_wet = (load(scale, c) > zero) & (share > zero)
            store(scale, c, select(is_wet, 1.0 / select(is_wet, share, zero + 1.0), zero))


@kernel
def restrict(rows, block, children, size, remainder, sums):
    """Sum the remainder of the finer level for the cells of some coarse blocks, in 1/64 quanta.

    Args:
        rows: Coarse blocks, shape (n,).
        block, children: Coordinates of the coarse blocks, and tables; see CoarseBlocks.
        size: Cells of the finer level along each axis, shape (3,).
        remainder: Whole numbers of the finer level, flat.
        sums: Sums by coarse block, shape (m, 64) (out).
    """
    fine, partial, column = np.empty((10, 10, 10)), np.empty((4, 10, 10)), np.empty((4, 4, 10))
    weights = np.empty((3, 4, 4))
    for b in rows:
        for a in range(3):
            for j in range(4):
                for t in range(4):  # of the four cells around the coarse one, -1 to 2
                    place = 8 * block[b, a] + 2 * j + t - 1
                    is_own = t == 1 or t == 2
                    at_wall = (t == 1 and place == 0) or (t == 2 and place == size[a] - 1)
                    weights[a, j, t] = 4.0 if at_wall else (3.0 if is_own else 1.0)
        for x in range(10):
            for y in range(10):
                line = 64 * b + 16 * ((x + 3) // 4) + 4 * ((y + 3) // 4)
                cell = 16 * ((x + 3) % 4) + 4 * ((y + 3) % 4)
                fine[x, y, 0] = remainder[64 * children[line] + cell + 3]
                for z in range(4):
                    fine[x, y, z + 1] = remainder[64 * children[line + 1] + cell + z]
                    fine[x, y, z + 5] = remainder[64 * children[line + 2] + cell + z]
                fine[x, y, 9] = remainder[64 * children[line + 3] + cell]
        for i in range(4):
            w = weights[0, i]
            for y in range(10):
                for z in range(10):
                    partial[i, y, z] = (
                        (w[0] * fine[2 * i, y, z] + w[1] * fine[2 * i + 1, y, z])
                        + (w[2] * fine[2 * i + 2, y, z] + w[3] * fine[2 * i + 3, y, z])
                    )  # fmt: skip
        for j in range(4):
            w = weights[1, j]
            for i in range(4):
                for z in range(10):
                    column[i, j, z] = (
                        (w[0] * partial[i, 2 * j, z] + w[1] * partial[i, 2 * j + 1, z])
                        + (w[2] * partial[i, 2 * j + 2, z] + w[3] * partial[i, 2 * j + 3, z])
                    )  # fmt: skip
        for k in range(4):
            w = weights[2, k]
            for i in range(4):
                for j in range(4):
                    sums[b, 16 * i + 4 * j + k] = (
                        (w[0] * column[i, j, 2 * k] + w[1] * column[i, j, 2 * k + 1])
                        + (w[2] * column[i, j, 2 * k + 2] + w[3] * column[i, j, 2 * k + 3])
                    )  # fmt: skip


@kernel
def set_residual(rows, quantum, sums, level):
    """Set the residual of the cells of some coarse blocks.

    Args:
        rows: Coarse blocks, shape (n,).
        quantum: Unit of the remainder.
        sums: See `restrict`.
        level: LevelFields of the coarse levels (in/out).
    """
    real = level.scale.dtype.type
    for b in rows:
        for q in range(64):
            is_wet = level.scale[64 * b + q] > 0
            level.residual[64 * b + q] = real(sums[b, q] * quantum / 64.0) if is_wet else real(0)


@kernel
def interpolate(rows, block, parent, size, coarse, lattice, scale, correction):
    """Add the interpolated correction of the coarser level to that of some blocks.

    Args:
        rows: Blocks, shape (n,).
        block, parent: Their coordinates, and the coarse blocks that cover them.
        size: Cells of their level along each axis, shape (3,).
        coarse: Correction of the coarse levels, flat.
        lattice: Lattice of the coarse blocks.
        scale, correction: Fields of their level; the correction is (in/out).
    """
    real = correction.dtype.type
    near_weight, far_weight = real(0.75), real(0.25)
    source, along_x, along_y = (
        np.empty((4, 4, 4), correction.dtype),
        np.empty((4, 4, 4), correction.dtype),
        np.empty((4, 4, 4), correction.dtype),
    )
    # place of the coarse cell, and of the one beside it, among the four around the block
    own_cell, other_cell = np.empty((3, 4), np.int64), np.empty((3, 4), np.int64)
    none = len(lattice.neighbors) // 27
    for b in rows:
        if parent[b] == none:
            continue
        for a in range(3):
            for i in range(4):
                place = 4 * block[b, a] + i
                own_cell[a, i] = 1 + i // 2
                is_beyond = place == 0 or (place == size[a] - 1 and place % 2 == 1)
                other_cell[a, i] = own_cell[a, i] + (0 if is_beyond else (1 if i % 2 else -1))
        hx, hy, hz = block[b, 0] % 2, block[b, 1] % 2, block[b, 2] % 2
        for x in range(4):
            cx = 2 * hx - 1 + x + 4
            for y in range(4):
                cy = 2 * hy - 1 + y + 4
                line = 27 * parent[b] + 9 * (cx // 4) + 3 * (cy // 4)
                for z in range(4):
                    cz = 2 * hz - 1 + z + 4
                    cell = 16 * (cx % 4) + 4 * (cy % 4) + cz % 4
                    source[x, y, z] = coarse[64 * lattice.neighbors[line + cz // 4] + cell]
        for i in range(4):
            p, q = own_cell[0, i], other_cell[0, i]
            for y in range(4):
                for z in range(4):
                    along_x[i, y, z] = near_weight * source[p, y, z] + far_weight * source[q, y, z]
        for j in range(4):
            p, q = own_cell[1, j], other_cell[1, j]
            for i in range(4):
                for z in range(4):
                    along_y[i, j, z] = (
                        near_weight * along_x[i, p, z] + far_weight * along_x[i, q, z]
                    )
        for k in range(4):
            p, q = own_cell[2, k], other_cell[2, k]
            for i in range(4):
                for j in range(4):
                    c = 64 * b + 16 * i + 4 * j + k
                    if scale[c] > 0:
                        correction[c] += (
                            near_weight * along_y[i, j, p] + far_weight * along_y[i, j, q]
                        )


@kernel
def cycle(wet, blocks, factors, last_factors, counted, quantum, sums, level):
    """Make a cycle over the coarse levels, which every rank computes alike.

    Args:
        wet: WetRows.
        blocks: CoarseBlocks.
        factors, last_factors: Factors of the sweeps before and after, and on the last level.
        counted: 1 for all cells.
        quantum: Quantum of the remainder on level 1.
        sums: Scratch, shape (m, 64).
        level: LevelFields of the coarse levels (in/out).
    """
    real = level.scale.dtype.type
    per_quantum, last = real(1.0 / quantum), len(blocks.first) - 2
    for n in range(last + 1):
        cells = wet.cells[wet.first_cell[n] : wet.first_cell[n + 1]]
        nodes = wet.nodes[wet.first_node[n] : wet.first_node[n + 1]]
        own = last_factors if n == last else factors
        begin_sweeps(cells, own[0, 0], level)
        sweep(cells, nodes, blocks.lattice, own[1:], level)
        if n < last:
            respond(nodes, blocks.lattice, level.correction, level)
            find_remainder(cells, blocks.lattice, counted, per_quantum, level)
            coarser = wet.cells[wet.first_cell[n + 1] : wet.first_cell[n + 2]]
            restrict(
                coarser,
                blocks.lattice.block,
                blocks.children,
                blocks.sizes[n + 1],
                level.remainder,
                sums,
            )
            set_residual(coarser, quantum, sums, level)
    for n in range(last - 1, -1, -1):
        cells = wet.cells[wet.first_cell[n] : wet.first_cell[n + 1]]
        nodes = wet.nodes[wet.first_node[n] : wet.first_node[n + 1]]
        interpolate(
            cells, blocks.lattice.block, blocks.parent, blocks.sizes[n + 1], level.correction,
            blocks.lattice, level.scale, level.correction,
        )  # fmt: skip
        sweep(cells, nodes, blocks.lattice, factors, level)
