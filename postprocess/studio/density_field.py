"""Density field of a liquid in sparse blocks; the surface is where the density is 1/2.

    rho(x) = sum_p a w(|V_p^-1 (x - x_p)| / (R s_p)),  w(q) = (1 - q^2)^3,  a = 315 / (64 pi R^3)

V_p is the stretch of the seeding lattice around particle p (lattice_deformation.py). The amplitude
is not divided by det V: where the lattice is intact, rho is that of the reference lattice, so thin
sheets keep rho = 1. At walls rho is divided by the fraction of the round kernel inside of the
domain, so that it stays 1 up to the wall, which cuts a flat face.

Blocks of 8^3 cells exist only near the surface. Where the liquid is filled around a particle beyond
its kernel's radius, nothing is deposited: blocks in there are marked full. Cubes of 4 cells store
the distance to the next one that the surface may cross, so that rays skip space.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF
from .lattice_deformation import jacobi
from .sparse_blocks import (
    BLOCK,
    FULL,
    NODES,
    assemble_nodes,
    deposit_blocks,
    mark_blocks,
    mark_bricks,
    mark_full_blocks,
    rows_near_surface,
)
from .value_grid import KERNEL, Grid, deposit, new_grid

SIGMA = 0.68  # [spacings] standard deviation of a kernel
SMOOTH = 0.3  # [spacings] standard deviation of the field's smoothing
REACH = SIGMA * np.sqrt(11.0)  # [spacings] radius of a kernel
MARGIN = 1.5  # [spacings] additional depth of particles that count as interior
FILLED = 0.9  # [bulk densities] density above which a cell is full
MIN_FRACTION = 0.3  # [-] least fraction of a kernel inside of the walls that divides rho
MAX_CELLS = 1.6e8  # [cells] of the dense grid, above which cells become coarser


class Field(NamedTuple):
    """Density field of a liquid.

    Attributes:
        index: Block numbers, shape (bx, by, bz) int32; -1: empty, -2: full.
        bricks: Cubes of 4 cells, shape (2 bx, 2 by, 2 bz) int16: 0 where the surface may be; -d in
            an empty cube d cubes from the next one that is not empty; d in a full one.
        values: Node values, shape (blocks, 9, 9, 9) float32.
        lower: Position of the first node, shape (3,) [m].
        cell: Cell size [m].
        box: Lower and upper corner of the space where the liquid can be, shape (6,) [m].
        walls: Whether its sides are walls, shape (6,): -x -y -z +x +y +z.
    """

    index: np.ndarray  # type: ignore[assignment]  # hides a method of tuple
    bricks: np.ndarray
    values: np.ndarray
    lower: np.ndarray
    cell: float
    box: np.ndarray
    walls: np.ndarray


class Interior(NamedTuple):
    """Distances to unfilled space on a coarse grid, and mean values of the particles.

    Attributes:
        distance: Grid of distances [m].
        means: Grid of the particles' mean values, shape (nx, ny, nz, channels).
        density: Grid of densities, 1 in the bulk.
    """

    distance: Grid
    means: Grid
    density: Grid


def empty_field() -> Field:
    """Return a field without any liquid."""
    index = np.full((1, 1, 1), -1, np.int32)
    values = np.zeros((1, NODES, NODES, NODES), np.float32)
    box = np.array([0.0, 0.0, 0.0, -1.0, -1.0, -1.0])
    bricks = np.full((2, 2, 2), -1, np.int16)
    return Field(index, bricks, values, np.zeros(3), 1.0, box, np.zeros(6, bool))


def wall_share(position: np.ndarray, low: float, high: float, sigma: float) -> np.ndarray:
    """Return the fraction of a Gaussian between two walls.

    Args:
        position: Centers, shape (n,) [m].
        low, high: Positions of the walls [m].
        sigma: Standard deviation [m].

    Returns:
        Fractions, shape (n,), at least MIN_FRACTION.
    """
    from scipy.special import ndtr

    inside = np.clip(position, low, high)
    return np.maximum(ndtr((inside - low) / sigma) - ndtr((inside - high) / sigma), MIN_FRACTION)


def wall_shares(grid_lower, shape, cell, box, walls, sigma) -> list[np.ndarray]:
    """Return the fractions of Gaussians between the walls along the three axes of a grid.

    Args:
        grid_lower, shape, cell: Grid.
        box: Corners of the domain, shape (6,) [m].
        walls: Whether its sides are walls, shape (6,); open sides are infinitely far away.
        sigma: Standard deviation [m].
    """
    out = []
    for a in range(3):
        positions = grid_lower[a] + cell * np.arange(shape[a])
        low = box[a] if walls[a] else -np.inf
        high = box[3 + a] if walls[3 + a] else np.inf
        out.append(wall_share(positions, low, high, sigma).astype(np.float32))
    return out


def interior(
    x: np.ndarray, spacing: np.ndarray, values: np.ndarray, box: np.ndarray, walls: np.ndarray
) -> Interior:
    """Find where a liquid fills space, and the means of its particles' values.

    Args:
        x: Positions, shape (n, 3) [m].
        spacing: Spacings of the particles, shape (n,) [m].
        values: Values of the particles, shape (n, channels).
        box: Corners of the domain, shape (6,) [m].
        walls: Whether its sides are walls, shape (6,).
    """
    from scipy import ndimage

    cell = float(np.median(spacing))
    reach = 2.2
    bounds = x.min(axis=0) - 3 * cell, x.max(axis=0) + 3 * cell
    low = np.where(walls[:3], np.maximum(bounds[0], box[:3] - 3 * cell), bounds[0])
    high = np.where(walls[3:], np.minimum(bounds[1], box[3:] + 3 * cell), bounds[1])
    total, sums = new_grid(low, high, cell), new_grid(low, high, cell, values.shape[1])
    cell = total.cell  # coarser where particles are far apart
    deposit(x, reach * spacing, np.full(len(x), KERNEL / reach**3), values, total, sums)
    has_weight = total.values > 1e-4
    sums.values[has_weight] /= total.values[has_weight][:, None]
    sums.values[~has_weight] = np.average(values, axis=0)
    shape = total.values.shape
    for a, share in enumerate(
        wall_shares(total.lower, shape, cell, box, walls, reach / np.sqrt(11) * cell)
    ):
        total.values[:] /= share.reshape([-1 if k == a else 1 for k in range(3)])
    full = total.values > FILLED
    # the liquid continues beyond a wall
    inner_nodes = [
        np.clip(
            np.arange(shape[a]),
            np.ceil((box[a] - total.lower[a]) / cell - 1e-6) if walls[a] else 0,
            np.floor((box[3 + a] - total.lower[a]) / cell + 1e-6) if walls[3 + a] else shape[a] - 1,
        ).astype(int)
        for a in range(3)
    ]
    full = full[np.ix_(*inner_nodes)]
    # space beyond the grid lies behind walls only
    distance = ndimage.distance_transform_edt(full) if not full.all() else np.full(shape, 1e3)
    distance_grid = Grid((distance * cell).astype(np.float32), total.lower, cell)
    return Interior(distance_grid, sums, total)


def liquid_field(
    x: np.ndarray,
    spacing: np.ndarray,
    stretch: np.ndarray,
    inside: Interior,
    box: np.ndarray,
    walls: np.ndarray,
    resolution: float,
) -> Field:
    """Build the density field of a liquid.

    Args:
        x: Positions, shape (n, 3) [m].
        spacing: Spacings of the particles, shape (n,) [m].
        stretch: Upper triangles of V, shape (n, 6).
        inside: Result of `interior`.
        box: Corners of the domain, shape (6,) [m].
        walls: Whether its sides are walls, shape (6,).
        resolution: Cells per spacing.
    """
    s = float(np.median(spacing))
    half, metric, amplitude = np.empty((len(x), 3)), np.empty((len(x), 6)), np.empty(len(x))
    _kernels(np.ascontiguousarray(stretch), REACH * spacing, half, metric, amplitude)
    low, high = (x - half).min(axis=0), (x + half).max(axis=0)
    low = np.where(walls[:3], np.maximum(low, box[:3]), low)
    high = np.where(walls[3:], np.minimum(high, box[3:]), high)
    cells = np.prod(np.maximum(high - low, s) / s) * resolution**3
    cell = s / resolution * max(1.0, float(np.cbrt(cells / MAX_CELLS)))
    first = np.floor(low / (BLOCK * cell)).astype(np.int64) * BLOCK
    blocks = ((np.ceil(high / cell) + 1 - first) / BLOCK).astype(np.int64) + 1
    lower = first * cell
    dist = inside.distance
    surface = rows_near_surface(x, half.max(axis=1), dist.values, dist.lower, dist.cell, MARGIN * s)
    x, half, metric = x[surface], half[surface], metric[surface]
    index = np.full(tuple(blocks), -1, np.int32)
    amplitude = amplitude[surface] * KERNEL / REACH**3
    mark_blocks(x, half, lower, cell, index)
    touched = np.flatnonzero(index.ravel() >= 0)
    index.ravel()[touched] = np.arange(len(touched))
    raw = np.zeros((max(len(touched), 1), BLOCK, BLOCK, BLOCK), np.float32)
    deposit_blocks(x, half, metric, amplitude, lower, cell, index, raw.ravel())
    nodes = blocks * BLOCK + 1
    shares = wall_shares(lower, nodes, cell, box, walls, np.hypot(SIGMA, SMOOTH) * s)
    values = np.empty((len(raw), NODES, NODES, NODES), np.float32)
    mark_full_blocks(index, dist.values, dist.lower, dist.cell, lower, cell, MARGIN * s)
    assemble_nodes(
        index, raw, shares[0], shares[1], shares[2], dist, lower, cell, MARGIN * s, values
    )
    limits = np.concatenate([lower, lower + (nodes - 1) * cell])
    limits[:3] = np.where(walls[:3], box[:3], limits[:3])
    limits[3:] = np.where(walls[3:], box[3:], limits[3:])
    return Field(
        index, _bricks(index, values), values, lower, cell, limits, np.asarray(walls, bool)
    )


@njit_cached(nogil=True, error_model="numpy")
def _kernels(stretch, radius, half, metric, amplitude):
    """Return kernels of stretches (n, 6), smoothed by a Gaussian.

    Variances add, V^2 + (SMOOTH / SIGMA)^2, and a wider kernel is lower in proportion.

    Args:
        stretch: Upper triangles of V, shape (n, 6).
        radius: Radii of the undeformed kernels, shape (n,) [m].
        half: (out) Half edges of the boxes around them, shape (n, 3) [m].
        metric: (out) Upper triangles of W^-2 / radius^2, W the wider stretch, shape (n, 6) [1/m2].
        amplitude: (out) det V / det W, shape (n,).
    """
    smoothing = (SMOOTH / SIGMA) ** 2
    C, Q = np.empty((3, 3)), np.empty((3, 3))
    for p in range(len(stretch)):
        C[0, 0], C[0, 1], C[0, 2] = stretch[p, 0], stretch[p, 1], stretch[p, 2]
        C[1, 0], C[1, 1], C[1, 2] = stretch[p, 1], stretch[p, 3], stretch[p, 4]
        C[2, 0], C[2, 1], C[2, 2] = stretch[p, 2], stretch[p, 4], stretch[p, 5]
        jacobi(C, Q)
        radius2 = radius[p] * radius[p]
        lower, k = 1.0, 0
        for m in range(3):
            v = C[m, m] * C[m, m]
            lower *= v / (v + smoothing)
            C[m, m] = v + smoothing
        amplitude[p] = np.sqrt(lower)
        for a in range(3):
            half[p, a] = radius[p] * np.sqrt(
                Q[a, 0] * Q[a, 0] * C[0, 0] + Q[a, 1] * Q[a, 1] * C[1, 1]
                + Q[a, 2] * Q[a, 2] * C[2, 2]
            )  # fmt: skip
            for b in range(a, 3):
                metric[p, k] = (
                    Q[a, 0] * Q[b, 0] / C[0, 0] + Q[a, 1] * Q[b, 1] / C[1, 1]
                    + Q[a, 2] * Q[b, 2] / C[2, 2]
                ) / radius2  # fmt: skip
                k += 1


def _bricks(index: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the distances that rays may skip, for every cube of 4 cells."""
    from scipy.ndimage import distance_transform_cdt

    state = np.empty(tuple(2 * n for n in index.shape), np.int8)
    mark_bricks(index, values, state)
    out = np.zeros(state.shape, np.int16)
    for kind in (-1, 1):
        mask = state == kind
        if mask.all():
            out[:] = kind * 500
        elif mask.any():
            distance = distance_transform_cdt(mask, metric="chessboard")
            out[mask] = kind * np.minimum(distance[mask], 500)
    return out


@njit_cached(**LEAF)
def density(field, x, y, z):
    """Return rho at grid coordinates, 0 outside of the grid.

    Args:
        field: The field.
        x, y, z: Grid coordinates [cells].
    """
    nx, ny, nz = field.index.shape
    if not (x >= 0.0 and y >= 0.0 and z >= 0.0):
        return np.float32(0.0)
    i, j, k = int(x), int(y), int(z)
    if i >= nx << 3 or j >= ny << 3 or k >= nz << 3:
        return np.float32(0.0)
    n = field.index[i >> 3, j >> 3, k >> 3]
    if n < 0:
        return np.float32(1.0) if n == FULL else np.float32(0.0)
    a, b, c = np.float32(x - i), np.float32(y - j), np.float32(z - k)
    i, j, k = i & 7, j & 7, k & 7
    v = field.values[n]
    v00 = v[i, j, k] + c * (v[i, j, k + 1] - v[i, j, k])
    v01 = v[i, j + 1, k] + c * (v[i, j + 1, k + 1] - v[i, j + 1, k])
    v10 = v[i + 1, j, k] + c * (v[i + 1, j, k + 1] - v[i + 1, j, k])
    v11 = v[i + 1, j + 1, k] + c * (v[i + 1, j + 1, k + 1] - v[i + 1, j + 1, k])
    v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
    return v0 + a * (v1 - v0)


@njit_cached(nogil=True, error_model="numpy")
def _densities(field, x, out):
    """Write rho at the points x (n, 3) [m] to out (n,)."""
    for p in range(len(x)):
        out[p] = density(
            field,
            (x[p, 0] - field.lower[0]) / field.cell,
            (x[p, 1] - field.lower[1]) / field.cell,
            (x[p, 2] - field.lower[2]) / field.cell,
        )


def densities(field: Field, x: np.ndarray) -> np.ndarray:
    """Return rho (n,) at the points x (n, 3) [m], with points beyond a wall moved onto it."""
    x = np.clip(x, field.box[:3], field.box[3:]) if len(x) else x
    out = np.empty(len(x))
    _densities(field, np.ascontiguousarray(x, dtype=np.float64), out)
    return out
