"""Dense grids of values with trilinear sampling, and deposition of particles on them."""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY

MAX_NODES = 6e7  # [nodes] of a grid, above which its cells become coarser
KERNEL = 315 / (64 * np.pi)  # [-] factor that normalizes (1 - q^2)^3 of radius 1


class Grid(NamedTuple):
    """Node values in space.

    Attributes:
        values: Node values, shape (nx, ny, nz) or (nx, ny, nz, channels) float32.
        lower: Position of node 0, 0, 0, shape (3,) [m].
        cell: Cell size [m].
    """

    values: np.ndarray
    lower: np.ndarray
    cell: float


def new_grid(lower: np.ndarray, upper: np.ndarray, cell: float, channels: int = 0) -> Grid:
    """Return a grid of zeros whose nodes lie on multiples of the cell.

    Args:
        lower, upper: Corners of the region that it covers, shape (3,) [m].
        cell: Cell size [m]; larger cells are taken where the grid would be too large.
        channels: Values per node, or 0 for one value without an axis of channels.
    """
    sides = np.maximum((np.asarray(upper) - lower) / cell, 1.0)
    cell = cell * max(1.0, float(np.cbrt(np.prod(sides) / MAX_NODES)), float(sides.max()) / 1e6)
    first = np.floor(np.asarray(lower) / cell)
    shape = tuple((np.ceil(np.asarray(upper) / cell) - first).astype(int) + 1)
    shape += (channels,) if channels else ()
    return Grid(np.zeros(shape, np.float32), first * cell, float(cell))


@njit_cached(**RAY)
def trilinear(v, x, y, z):
    """Return the value at grid coordinates, 0 outside.

    Args:
        v: Node values, shape (nx, ny, nz).
        x, y, z: Grid coordinates [cells].
    """
    nx, ny, nz = v.shape
    if not (x >= 0.0 and y >= 0.0 and z >= 0.0 and x < nx - 1 and y < ny - 1 and z < nz - 1):
        return 0.0
    i, j, k = int(x), int(y), int(z)
    a, b, c = x - i, y - j, z - k
    v00 = v[i, j, k] + c * (v[i, j, k + 1] - v[i, j, k])
    v01 = v[i, j + 1, k] + c * (v[i, j + 1, k + 1] - v[i, j + 1, k])
    v10 = v[i + 1, j, k] + c * (v[i + 1, j, k + 1] - v[i + 1, j, k])
    v11 = v[i + 1, j + 1, k] + c * (v[i + 1, j + 1, k + 1] - v[i + 1, j + 1, k])
    v0, v1 = v00 + b * (v01 - v00), v10 + b * (v11 - v10)
    return v0 + a * (v1 - v0)


@njit_cached(**LEAF)
def trilinear_values(v, x, y, z, count, out):
    """Write the first values of a grid of channels at grid coordinates clamped to it.

    Args:
        v: Node values, shape (nx, ny, nz, channels).
        x, y, z: Grid coordinates [cells].
        count: Number of channels.
        out: (out) Values, shape (count,).
    """
    nx, ny, nz = v.shape[0], v.shape[1], v.shape[2]
    x, y, z = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0), min(max(z, 0.0), nz - 1.0)
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    a, b, c = x - i, y - j, z - k
    p, q, r, s = (1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b
    d = 1.0 - c
    for m in range(count):
        below = p * v[i, j, k, m] + q * v[i, j + 1, k, m]
        below += r * v[i + 1, j, k, m] + s * v[i + 1, j + 1, k, m]
        above = p * v[i, j, k + 1, m] + q * v[i, j + 1, k + 1, m]
        above += r * v[i + 1, j, k + 1, m] + s * v[i + 1, j + 1, k + 1, m]
        out[m] = d * below + c * above


@njit_cached(nogil=True, error_model="numpy")
def _sample(v, lower, cell, x, out):
    """Write the values at the points x (n, 3) [m] to out (n,)."""
    for p in range(len(x)):
        out[p] = trilinear(
            v, (x[p, 0] - lower[0]) / cell, (x[p, 1] - lower[1]) / cell, (x[p, 2] - lower[2]) / cell
        )


def sample(grid: Grid, x: np.ndarray) -> np.ndarray:
    """Return the values (n,) at the points x (n, 3) [m], 0 outside."""
    out = np.empty(len(x))
    _sample(grid.values, grid.lower, grid.cell, np.ascontiguousarray(x, dtype=np.float64), out)
    return out


@njit_cached(nogil=True, error_model="numpy")
def _deposit(x, radius, weight, values, lower, cell, total, sums):
    """Scatter weights and weighted values of the particles to the nodes."""
    nx, ny, nz = total.shape
    channels = values.shape[1]
    for p in range(len(x)):
        r = radius[p] / cell
        X, Y, Z = (
            (x[p, 0] - lower[0]) / cell,
            (x[p, 1] - lower[1]) / cell,
            (x[p, 2] - lower[2]) / cell,
        )
        inverse = 1.0 / (r * r)
        for i in range(max(0, int(np.ceil(X - r))), min(nx - 1, int(np.floor(X + r))) + 1):
            u = 1.0 - (i - X) * (i - X) * inverse
            for j in range(max(0, int(np.ceil(Y - r))), min(ny - 1, int(np.floor(Y + r))) + 1):
                w = u - (j - Y) * (j - Y) * inverse
                if w <= 0.0:
                    continue
                half = r * np.sqrt(w)
                for k in range(
                    max(0, int(np.ceil(Z - half))), min(nz - 1, int(np.floor(Z + half))) + 1
                ):
                    t = w - (k - Z) * (k - Z) * inverse
                    t = weight[p] * t * t * t
                    total[i, j, k] += t
                    for m in range(channels):
                        sums[i, j, k, m] += t * values[p, m]


def deposit(
    x: np.ndarray,
    radius: np.ndarray,
    weight: np.ndarray,
    values: np.ndarray,
    total: Grid,
    sums: Grid,
) -> None:
    """Add weight (1 - q^2)^3 of every particle to `total` and its values times that to `sums`.

    Args:
        x: Positions, shape (n, 3) [m].
        radius: Radii of the kernels, shape (n,) [m].
        weight: Heights of the kernels, shape (n,).
        values: Values, shape (n, channels); no channels where only `total` is needed.
        total: (in/out) Grid of weights.
        sums: (in/out) Grid of weighted values, with the nodes of `total`.
    """
    _deposit(
        np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(radius, dtype=np.float64),
        np.ascontiguousarray(weight, dtype=np.float64), np.ascontiguousarray(values,
        dtype=np.float64),
        total.lower, total.cell, total.values, sums.values,
    )  # fmt: skip
