"""Dense grids of values with trilinear sampling, and deposits of particles on them."""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY

MOST_NODES = 6e7  # of a grid, above which its cells become coarser
KERNEL = 315 / (64 * np.pi)  # of (1 - q^2)^3 with radius 1: its integral is 1


class Grid(NamedTuple):
    """Node values in space.

    Attributes:
        values: (nx, ny, nz) or (nx, ny, nz, channels) float32.
        lower: (3,) position of node 0, 0, 0 [m].
        cell: edge [m].
    """

    values: np.ndarray
    lower: np.ndarray
    cell: float


def new_grid(lower: np.ndarray, upper: np.ndarray, cell: float, channels: int = 0) -> Grid:
    """A grid of zeros over lower .. upper whose nodes lie on multiples of the cell."""
    sides = np.maximum((np.asarray(upper) - lower) / cell, 1.0)
    cell = cell * max(1.0, float(np.cbrt(np.prod(sides) / MOST_NODES)), float(sides.max()) / 1e6)
    first = np.floor(np.asarray(lower) / cell)
    shape = tuple((np.ceil(np.asarray(upper) / cell) - first).astype(int) + 1)
    shape += (channels,) if channels else ()
    return Grid(np.zeros(shape, np.float32), first * cell, float(cell))


@cached(**RAY)
def trilinear(v, x, y, z):
    """Value (nx, ny, nz) at grid coordinates, 0 outside."""
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


@cached(**RAY)
def trilinear_values(v, x, y, z, count, out):
    """First `count` values of a grid of channels at grid coordinates moved into it, into out
    (count,)."""
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


@cached(nogil=True, error_model="numpy")
def _sample(v, lower, cell, x, out):
    for p in range(len(x)):
        out[p] = trilinear(
            v, (x[p, 0] - lower[0]) / cell, (x[p, 1] - lower[1]) / cell, (x[p, 2] - lower[2]) / cell
        )


def sample(grid: Grid, x: np.ndarray) -> np.ndarray:
    """Values (n,) at the points x (n, 3) [m], 0 outside."""
    out = np.empty(len(x))
    _sample(grid.values, grid.lower, grid.cell, np.ascontiguousarray(x, dtype=np.float64), out)
    return out


@cached(nogil=True, error_model="numpy")
def _deposit(x, radius, weight, values, lower, cell, total, sums):
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
        x: (n, 3) positions [m].
        radius: (n,) of the kernels [m].
        weight: (n,) at their middles.
        values: (n, channels); no channels where only `total` is wanted.
        total: grid of weights.
        sums: grid of weighted values, with the nodes of `total`.
    """
    _deposit(
        np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(radius, dtype=np.float64),
        np.ascontiguousarray(weight, dtype=np.float64), np.ascontiguousarray(values,
        dtype=np.float64),
        total.lower, total.cell, total.values, sums.values,
    )  # fmt: skip
