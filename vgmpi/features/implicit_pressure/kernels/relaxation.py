"""Chebyshev sweeps over the cells of a level: the system D M^-1 D^T of its nodes, and its diagonal.

Potentials belong to cells, velocities to nodes. With D the divergence of the eight nodes of a cell
and M the masses of the nodes, a sweep brings D M^-1 D^T correction nearer to the residual. The
number of sweeps is fixed, so that all ranks agree (docs/explanation/implicit-pressure.md).
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.vector16 import load, load_wide, pointer, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import kernel

from .cell_stencils import differences_below, divergence

MAX_EIGENVALUE = 8.0 / 3.0  # of the system in space, each row over its diagonal
NODAL = ("u", "inverse")  # fields of three numbers per node


class LevelFields(NamedTuple):
    """Numbers of the cells and nodes of a level, flat, in the working precision.

    A block has 192 numbers of nodes, axis after axis, or 64 of cells.
    """

    u: np.ndarray  # velocities of the nodes
    inverse: np.ndarray  # responses of the nodes by axis, 0 where a wall holds the node
    scale: np.ndarray  # inverse diagonal, 0 for cells without pressure
    residual: np.ndarray  # right-hand side less the product with phi
    correction: np.ndarray  # change of phi that the sweeps find
    step: np.ndarray  # last change of the correction
    remainder: np.ndarray  # residual that a correction leaves, in quanta


def level_fields(blocks: int, real: np.dtype) -> LevelFields:
    """Return fields of zeros for some blocks and the row of no block."""
    sizes = ((blocks + 1) * (192 if name in NODAL else 64) for name in LevelFields._fields)
    return LevelFields(*(aligned_zeros(size, real) for size in sizes))


class Sweeps(NamedTuple):
    """Chebyshev sweeps over a system."""

    number: int
    min_eigenvalue: float  # [-] below it, the sweeps do little


@cache
def chebyshev_factors(sweeps: Sweeps, real: np.dtype) -> np.ndarray:
    """Return factor of the residual and factor of the last change of each sweep, (sweeps, 2).

    References:
        Golub and Varga 1961: Chebyshev semi-iterative methods. Numer. Math. 3, 147-156.
    """
    middle = 0.5 * (MAX_EIGENVALUE + sweeps.min_eigenvalue)
    half = 0.5 * (MAX_EIGENVALUE - sweeps.min_eigenvalue)
    rho, factors = half / middle, [(1.0 / middle, 0.0)]
    for _ in range(sweeps.number - 1):
        following = 1.0 / (2.0 * middle / half - rho)
        factors.append((2.0 * following / half, following * rho))
        rho = following
    return np.array(factors, real)


@kernel
def respond(rows, lattice, potential, level):
    """Set u to M^-1 D^T of a potential at the nodes of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        potential: Numbers of the cells, flat.
        level: LevelFields (in/out).
    """
    low, phi = pointer(lattice.low), pointer(potential)
    inverse, u = pointer(level.inverse), pointer(level.u)
    for b in rows:
        s, y, z = differences_below(phi, low, 8 * b + 4, 48)
        for x in range(4):
            s_next, y_next, z_next = differences_below(phi, low, 8 * b, 16 * x)
            first = 192 * b + 16 * x
            store(u, first, 0.25 * load(inverse, first) * (s - s_next))
            first += 64
            store(u, first, 0.25 * load(inverse, first) * (y + y_next))
            first += 64
            store(u, first, 0.25 * load(inverse, first) * (z + z_next))
            s, y, z = s_next, y_next, z_next


@kernel
def begin_sweeps(rows, weight, level):
    """Make a sweep over the cells of some blocks, before which the correction is 0."""
    scale, residual = pointer(level.scale), pointer(level.residual)
    correction, step = pointer(level.correction), pointer(level.step)
    for b in rows:
        for c in range(64 * b, 64 * (b + 1), 16):
            change = weight * load(scale, c) * load(residual, c)
            store(step, c, change)
            store(correction, c, change)


@kernel
def relax(rows, lattice, weight, inertia, level):
    """Make a sweep over the cells of some blocks; u is the response to the correction.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        weight, inertia: Factors of the residual and of the last change.
        level: LevelFields (in/out).
    """
    high, u, residual = pointer(lattice.high), pointer(level.u), pointer(level.residual)
    scale, step, correction = pointer(level.scale), pointer(level.step), pointer(level.correction)
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            difference = load(residual, c) - divergence(u, high, b, x)
            change = weight * load(scale, c) * difference + inertia * load(step, c)
            store(step, c, change)
            store(correction, c, load(correction, c) + change)


@kernel
def sweep(cells, nodes, lattice, factors, level):
    """Make sweeps over a system whose cells no other thread or rank computes.

    Args:
        cells: Blocks of the cells, shape (n,).
        nodes: Blocks of the nodes around them, shape (m,).
        lattice: Blocks, Lattice.
        factors: Factors of the residual and of the last change by sweep, shape (sweeps, 2).
        level: LevelFields (in/out).
    """
    for k in range(len(factors)):
        respond(nodes, lattice, level.correction, level)
        relax(cells, lattice, factors[k, 0], factors[k, 1], level)


@kernel
def multiply(rows, lattice, product, level):
    """Store the divergence of u in the cells with pressure of some blocks.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        product: Numbers of the cells, flat (out).
        level: LevelFields.
    """
    high, u, scale, out = (
        pointer(lattice.high),
        pointer(level.u),
        pointer(level.scale),
        pointer(product),
    )
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            total = divergence(u, high, b, x)
            store(out, c, select(load(scale, c) > 0.0 * total, total, 0.0 * total))


@kernel
def find_remainder(rows, lattice, counted, per_quantum, level):
    """Count the residual that the correction leaves in quanta; u is the response to it.

    Args:
        rows: Blocks to process, shape (n,).
        lattice: Blocks, Lattice.
        counted: 1 for cells that this rank counts, else 0, flat.
        per_quantum: Quanta per unit, a power of two.
        level: LevelFields (in/out).
    """
    high, u, scale = pointer(lattice.high), pointer(level.u), pointer(level.scale)
    residual, remainder, counts = (
        pointer(level.residual),
        pointer(level.remainder),
        pointer(counted),
    )
    for b in rows:
        for x in range(4):
            c = 64 * b + 16 * x
            left = (load(residual, c) - divergence(u, high, b, x)) * load(counts, c)
            quanta = np.floor(per_quantum * left + 0.5)
            store(remainder, c, select(load(scale, c) > 0.0 * left, quanta, 0.0 * left))


@kernel
def sum_products(rows, a, b, counted, per_unit, sums):
    """Sum the products of two numbers of cells in units, and what rounding leaves in 2^-40 units.

    Args:
        rows: Blocks to process, shape (n,).
        a, b: Numbers of the cells, flat.
        counted: 1 for cells that this rank counts, else 0, flat.
        per_unit: Inverse of the unit.
        sums: Units, and parts of 2^-40 of a unit, shape (2,) int64 (out).
    """
    lanes = np.empty(16)
    first, second = 0, 0
    for block in rows:
        zero = 0.0 * load_wide(a, 64 * block)
        total, part = zero, zero
        for c in range(64 * block, 64 * (block + 1), 16):
            product = load_wide(a, c) * load_wide(b, c) * load_wide(counted, c) * per_unit
            units = np.floor(product + 0.5)
            total = total + units
            part = part + np.floor((product - units) * 2.0**40 + 0.5)
        store(lanes, 0, total)
        first += np.int64(lanes.sum())
        store(lanes, 0, part)
        second += np.int64(lanes.sum())
        first += second >> 40  # whole units, so that no number of blocks is too many
        second &= (1 << 40) - 1
    sums[0], sums[1] = first, second
