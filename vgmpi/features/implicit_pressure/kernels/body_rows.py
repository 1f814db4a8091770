"""Rows of free rigid bodies in the system of the pressure: J = D (theta X) of a body and a cell.

X are the six motions of a body at the nodes, theta its share of them. A body answers to a potential
with the change W J^T phi of its velocities, W the inverse of its inertia, so that the system has
J W J^T besides the response of the liquid. Lengths are in cells, masses in those of full cells.
Sums over cells are whole numbers of units and of remainders: their order does not matter.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import set_node_indices
from vgmpi.kernels.reproducible_sums import add_in_quanta
from vgmpi.runtime.jit import always_inline, kernel

from .cell_stencils import corner_node, corner_sign, is_held


class BodyRows(NamedTuple):
    """Cells with pressure next to free bodies; rows of one cell follow each other."""

    cell: np.ndarray  # (n,) flat index
    body: np.ndarray  # (n,)
    counts: np.ndarray  # (n,) 1 if this rank counts the cell, else 0
    jacobian: np.ndarray  # (n, 6) divergence in the cell per velocity of the body
    before: np.ndarray  # (n, 2) correction, and its last change, before a sweep


def body_rows(n: int) -> BodyRows:
    """Return a table of n rows."""
    return BodyRows(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n), np.zeros((n, 6)),
        np.zeros((n, 2)),
    )  # fmt: skip


@kernel
def find_rows(blocks, lattice, walls, colliders, centers, fields, scale, out):
    """Find the rows of some blocks; return their number, which may be above that of `out`.

    Args:
        blocks: Blocks to search, shape (n,).
        lattice: Blocks, Lattice.
        walls: Walls of the domain, which hold their nodes.
        colliders: ColliderNodes.
        centers: Centers of mass of the bodies [cells], shape (m, 3).
        fields: PressureFields.
        scale: Inverse diagonal, above 0 in the cells with pressure of this rank, flat.
        out: BodyRows, but for what this rank counts (out).
    """
    row, arm, weight, ijk = np.zeros(6), np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    count = 0
    for b in blocks:
        for q in range(64):
            cell = 64 * b + q
            if not scale[cell] > 0:
                continue
            first = count
            for corner in range(8):
                block, node = corner_node(b, q, corner, lattice)
                if block >= len(colliders.row) or colliders.row[block] < 0:
                    continue
                set_node_indices(ijk, lattice.block[block], node)
                body = colliders.body[colliders.row[block], node]
                free, share = fields.free_part[64 * block + node], fields.share[64 * block + node]
                of_solids = fields.solid_part[64 * block + node]
                if body < 0 or not free < 1 or not share + of_solids < 1:
                    continue
                for a in range(3):
                    arm[a] = ijk[a] - centers[body, a]
                    weight[a] = 0.25 * corner_sign(corner, a) * (1.0 - share - of_solids)
                    if is_held(block, node, a, lattice, walls):
                        weight[a] = 0.0
                row[0], row[1], row[2] = weight[0], weight[1], weight[2]
                row[3] = arm[1] * weight[2] - arm[2] * weight[1]
                row[4] = arm[2] * weight[0] - arm[0] * weight[2]
                row[5] = arm[0] * weight[1] - arm[1] * weight[0]
                place = first
                while place < min(count, len(out.cell)) and out.body[place] != body:
                    place += 1
                if place == count:
                    count += 1
                    if place < len(out.cell):
                        out.cell[place], out.body[place] = cell, body
                        out.jacobian[place] = 0.0
                if place < len(out.cell):
                    for a in range(6):
                        out.jacobian[place, a] += row[a]
    return count


@kernel
def subtract_divergence(count, rows, v, level):
    """Subtract the divergence that velocities of the bodies make from the residual.

    Args:
        count: Number of rows.
        rows: BodyRows.
        v: Velocities [cells/s] and angular velocities [1/s] of the bodies, shape (m, 6).
        level: LevelFields (in/out).
    """
    real = level.residual.dtype.type
    for n in range(count):
        level.residual[rows.cell[n]] -= real(_divergence(rows, n, v))


@always_inline
def _divergence(rows, n, v):
    """Return the divergence in the cell of a row that the velocities of its body make."""
    total, k = 0.0, rows.body[n]
    for a in range(6):
        total += rows.jacobian[n, a] * v[k, a]
    return total


@kernel
def sum_matrix(count, rows, level, per_unit, sums):
    """Sum J^T S J over the cells, S the inverse diagonal of the liquid.

    Args:
        count: Number of rows.
        rows: BodyRows.
        level: LevelFields.
        per_unit: Inverse of the unit.
        sums: Units and remainders, shape (6 m, 6 m, 2) int64 (in/out).
    """
    for n in range(count):
        scale = float(level.scale[rows.cell[n]]) * rows.counts[n]
        first = n
        while first > 0 and rows.cell[first - 1] == rows.cell[n]:
            first -= 1
        last = n
        while last + 1 < count and rows.cell[last + 1] == rows.cell[n]:
            last += 1
        for other in range(first, last + 1):
            for a in range(6):
                for b in range(6):
                    term = scale * rows.jacobian[n, a] * rows.jacobian[other, b]
                    add_in_quanta(
                        sums[6 * rows.body[n] + a], 6 * rows.body[other] + b, term, per_unit
                    )


@kernel
def sum_potential(count, rows, potential, per_unit, sums):
    """Sum J^T of a potential over the cells.

    Args:
        count: Number of rows.
        rows: BodyRows.
        potential: Numbers of the cells, flat.
        per_unit: Inverse of the unit.
        sums: Units and remainders, shape (6 m, 2) int64 (in/out).
    """
    for n in range(count):
        value = float(potential[rows.cell[n]]) * rows.counts[n]
        for a in range(6):
            add_in_quanta(sums, 6 * rows.body[n] + a, rows.jacobian[n, a] * value, per_unit)


@kernel
def note_correction(count, rows, level):
    """Store the correction and its last change at the cells, before a sweep."""
    for n in range(count):
        rows.before[n, 0] = level.correction[rows.cell[n]]
        rows.before[n, 1] = level.step[rows.cell[n]]


@kernel
def sum_sweep(count, rows, weight, inertia, level, per_unit, sums):
    """Sum J^T of the correction before a sweep, and J^T S of the residual that the sweep has seen.

    Args:
        count: Number of rows.
        rows: BodyRows.
        weight, inertia: Factors of the sweep, of the residual and of the last change.
        level: LevelFields after the sweep.
        per_unit: Inverse of the unit.
        sums: Units and remainders, shape (2, 6 m, 2) int64 (in/out).
    """
    for n in range(count):
        change = float(level.step[rows.cell[n]]) - float(inertia) * rows.before[n, 1]
        scaled = change / float(weight) * rows.counts[n]
        for a in range(6):
            k, part = 6 * rows.body[n] + a, rows.jacobian[n, a]
            add_in_quanta(sums[0], k, part * rows.before[n, 0] * rows.counts[n], per_unit)
            add_in_quanta(sums[1], k, part * scaled, per_unit)


@kernel
def correct_sweep(count, rows, weight, v, level):
    """Add to a sweep what the bodies answer.

    Args:
        count: Number of rows.
        rows: BodyRows.
        weight: Factor of the residual in the sweep.
        v: What the bodies answer to the sweep, shape (m, 6).
        level: LevelFields (in/out).
    """
    real = level.step.dtype.type
    for n in range(count):
        c = rows.cell[n]
        change = real(-float(weight) * float(level.scale[c]) * _divergence(rows, n, v))
        level.step[c] += change
        level.correction[c] += change


@kernel
def add_product(count, rows, v, product):
    """Add the divergence that velocities of the bodies make to a product with the system.

    Args:
        count: Number of rows.
        rows: BodyRows.
        v: Velocities, shape (m, 6).
        product: Numbers of the cells, flat (in/out).
    """
    real = product.dtype.type
    for n in range(count):
        product[rows.cell[n]] += real(_divergence(rows, n, v))


@kernel
def correct_remainder(count, rows, v, per_quantum, level):
    """Subtract the divergence that velocities of the bodies make from the remainder, in quanta.

    Args:
        count: Number of rows.
        rows: BodyRows.
        v: Velocities, shape (m, 6).
        per_quantum: Quanta per unit.
        level: LevelFields (in/out).
    """
    real = level.remainder.dtype.type
    for n in range(count):
        if not level.scale[rows.cell[n]] > 0:
            continue
        quanta = np.rint(_divergence(rows, n, v) * float(per_quantum))
        level.remainder[rows.cell[n]] -= real(quanta * rows.counts[n])


@kernel
def multiply_vector(matrix, vector, out):
    """Store the product of a matrix (n, n) and a vector (n,)."""
    for i in range(len(vector)):
        total = 0.0
        for j in range(len(vector)):
            total += matrix[i, j] * vector[j]
        out[i] = total


@kernel
def condense(mobility, matrix, out):
    """Store (1 + W B)^-1 W, by elimination with pivots.

    Args:
        mobility: W, shape (n, n).
        matrix: B, shape (n, n).
        out: Result, shape (n, n).
    """
    n = len(matrix)
    A = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = mobility[i, j]
            total = 1.0 if i == j else 0.0
            for k in range(n):
                total += mobility[i, k] * matrix[k, j]
            A[i, j] = total
    for c in range(n):
        pivot = c
        for i in range(c + 1, n):
            if abs(A[i, c]) > abs(A[pivot, c]):
                pivot = i
        for j in range(n):
            A[c, j], A[pivot, j] = A[pivot, j], A[c, j]
            out[c, j], out[pivot, j] = out[pivot, j], out[c, j]
        inverse = 1.0 / A[c, c]
        for j in range(n):
            A[c, j] *= inverse
            out[c, j] *= inverse
        for i in range(n):
            factor = A[i, c]
            if i != c and factor != 0.0:
                for j in range(n):
                    A[i, j] -= factor * A[c, j]
                    out[i, j] -= factor * out[c, j]
