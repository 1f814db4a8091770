"""Deformation of the seeding lattice from the current positions of reference neighbors.

Laws of fluids, sand and snow carry no total deformation gradient, but the lattice of the particles
gives one: column a of A is the mean edge to the two reference neighbors along axis a, per spacing.
Where neighbors have moved too far apart the lattice is torn, and that column is the unit vector
again. The tearing distance varies with smooth noise over the reference positions: one number would
tear bodies along planes of the lattice. Particles without a lattice (captures, meshes) take A by
weighted least squares over their nearest reference neighbors.

References:
    M. Müller, R. Keiser, A. Nealen, M. Pauly, M. Gross, M. Alexa. Point based animation of elastic,
    plastic and melting objects. SCA 2004.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

NEIGHBORS = 14  # [particles] neighbors of a particle without a lattice
TOLERANCE = 0.08  # [spacings] largest error of a lattice position
ON_LATTICE = 0.9  # [-] least fraction of particles with lattice neighbors in a lattice
FLAT = 0.001  # [-] det / trace^3 of the neighbors' moments below which they form a plane
NOISE_CELLS = 3.0  # [spacings] cell size of the noise in the tearing distance


class Links(NamedTuple):
    """Reference neighbors of particles.

    Attributes:
        axes: Rows of the neighbors at +x -x +y -y +z -z, shape (n, 6) int32; -1 for none.
        nearest: Rows of the nearest neighbors of particles without a lattice, shape (m, 14) int32.
        offsets: Reference vectors to these, shape (m, 14, 3) float32 [m].
        row: Row in `nearest` of a particle without a lattice, shape (n,) int32; -1 on the lattice.
    """

    axes: np.ndarray
    nearest: np.ndarray
    offsets: np.ndarray
    row: np.ndarray


def link(x0: np.ndarray, spacing: float) -> Links:
    """Find the reference neighbors of the particles of one body.

    Args:
        x0: Reference positions, shape (n, 3) [m].
        spacing: Spacing of the lattice [m].
    """
    n = len(x0)
    axes = _lattice_neighbors(x0, spacing)
    linked = (axes >= 0).any(axis=1)
    row = np.full(n, -1, np.int32)
    off_lattice = np.flatnonzero(~linked) if linked.mean() >= ON_LATTICE else np.arange(n)
    if len(off_lattice) == n:
        axes[:] = -1
    if n <= NEIGHBORS or not len(off_lattice):
        empty = np.zeros((0, NEIGHBORS))
        return Links(axes, empty.astype(np.int32), np.zeros((0, NEIGHBORS, 3), np.float32), row)
    from scipy.spatial import cKDTree  # slow to load, and not needed for bodies on a lattice

    nearest = cKDTree(x0).query(x0[off_lattice], k=NEIGHBORS + 1)[1][:, 1:].astype(np.int32)
    row[off_lattice] = np.arange(len(off_lattice))
    offsets = (x0[nearest] - x0[off_lattice][:, None, :]).astype(np.float32)
    return Links(axes, nearest, offsets, row)


def _lattice_neighbors(x0: np.ndarray, spacing: float) -> np.ndarray:
    """Return the rows of the neighbors along each axis (n, 6) int32, -1 for none."""
    out = np.full((len(x0), 6), -1, np.int32)
    if not len(x0):
        return out
    position = (x0 - x0.min(axis=0)) / spacing
    # phase of the lattice: most bodies are complete, some are cut obliquely by their shape
    phase = np.angle(np.exp(2j * np.pi * position).mean(axis=0)) / (2 * np.pi)
    position = position - phase
    cell = np.round(position)
    exact = (np.abs(position - cell) < TOLERANCE).all(axis=1)
    cell = cell.astype(np.int64) + 1
    shape = cell.max(axis=0) + 2
    if np.prod(shape.astype(float)) > 2.0**62:
        return out
    key = np.ravel_multi_index(cell.T, shape)
    key[~exact] = -1 - np.arange(np.count_nonzero(~exact))
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    steps = (shape[1] * shape[2], shape[2], 1)
    for column in range(6):
        target = key + (1 - 2 * (column % 2)) * steps[column // 2]
        index = np.minimum(np.searchsorted(ordered, target), len(ordered) - 1)
        is_neighbor = (ordered[index] == target) & exact
        out[is_neighbor, column] = order[index[is_neighbor]]
    return out


def tearing_distance(
    x0: np.ndarray, spacing: float, low: float, high: float, seed: int = 0
) -> np.ndarray:
    """Return the distance above which neighbors separate, from smooth noise.

    Args:
        x0: Reference positions, shape (n, 3) [m].
        spacing: Spacing of the lattice [m].
        low: Smallest distance [spacings].
        high: Largest distance [spacings].
        seed: Seed of the noise.

    Returns:
        Distances, shape (n,) [m].
    """
    from scipy import ndimage

    if not len(x0):
        return np.zeros(0)
    lower = x0.min(axis=0)
    shape = np.minimum(((x0.max(axis=0) - lower) / (NOISE_CELLS * spacing)).astype(int) + 3, 256)
    noise = np.random.default_rng(seed).random(tuple(shape))
    noise = 0.6 * noise + 0.4 * ndimage.gaussian_filter(noise, 1.0, mode="nearest")
    position = (x0 - lower) / (NOISE_CELLS * spacing)
    values = ndimage.map_coordinates(noise, position.T, order=1, mode="grid-wrap")
    values = (values - values.min()) / max(float(np.ptp(values)), 1e-9)
    return (low + (high - low) * values) * spacing


def stretches(
    x: np.ndarray,
    rows: np.ndarray,
    row_of: np.ndarray,
    links: Links,
    spacing: np.ndarray,
    torn: np.ndarray,
    low: float | np.ndarray,
    high: float | np.ndarray,
) -> np.ndarray:
    """Return symmetric stretch tensors of the lattice around particles.

    Args:
        x: Positions of the present particles, shape (m, 3) [m].
        rows: Their rows in `links`, shape (m,).
        row_of: Row in x of each particle of `links`, shape (n,); -1 for absent ones.
        links: Reference neighbors.
        spacing: Spacing of each particle's lattice, shape (n,) [m].
        torn: Distance at which its lattice is torn, shape (n,) [m].
        low: Smallest principal stretch, one or of each present particle (m,).
        high: Largest principal stretch, likewise.

    Returns:
        Upper triangles of V with A = V R and principal stretches within low .. high, shape (m, 6).
    """
    out = np.empty((len(x), 6))
    _stretches(
        np.ascontiguousarray(x, dtype=np.float64), rows, row_of, links, spacing, torn,
        np.full(len(x), low, np.float64), np.full(len(x), high, np.float64), out,
    )  # fmt: skip
    return out


@njit_cached(nogil=True, error_model="numpy")
def _edges(p, x, row, row_of, links, step, limit, A):
    """Fill in the columns of A for a particle on the lattice."""
    for a in range(3):
        count = 0
        e0 = e1 = e2 = 0.0
        for side in range(2):
            j = links.axes[row, 2 * a + side]
            if j < 0:
                continue
            j = row_of[j]
            if j < 0:
                continue
            d0, d1, d2 = x[j, 0] - x[p, 0], x[j, 1] - x[p, 1], x[j, 2] - x[p, 2]
            if d0 * d0 + d1 * d1 + d2 * d2 > limit * limit:
                continue
            sign = 1.0 if side == 0 else -1.0
            e0, e1, e2, count = e0 + sign * d0, e1 + sign * d1, e2 + sign * d2, count + 1
        if count:
            scale = 1.0 / (count * step)
            A[0, a], A[1, a], A[2, a] = e0 * scale, e1 * scale, e2 * scale
        else:
            A[0, a], A[1, a], A[2, a] = 0.0, 0.0, 0.0
            A[a, a] = 1.0


@njit_cached(nogil=True, error_model="numpy")
def _fit(p, x, k, row_of, links, step, limit, A, B, M):
    """Fit A by least squares over the nearest reference neighbors that are still close."""
    A[:], B[:], M[:] = 0.0, 0.0, 0.0
    count = 0
    for c in range(links.nearest.shape[1]):
        j = row_of[links.nearest[k, c]]
        if j < 0:
            continue
        D = links.offsets[k, c]
        size = D[0] * D[0] + D[1] * D[1] + D[2] * D[2]
        d0, d1, d2 = x[j, 0] - x[p, 0], x[j, 1] - x[p, 1], x[j, 2] - x[p, 2]
        if d0 * d0 + d1 * d1 + d2 * d2 > limit * limit * max(size / (step * step), 1.0):
            continue
        w = np.exp(-size / (1.44 * step * step))
        count += 1
        for b in range(3):
            A[0, b] += w * d0 * D[b]
            A[1, b] += w * d1 * D[b]
            A[2, b] += w * d2 * D[b]
            for a in range(3):
                B[a, b] += w * D[a] * D[b]
    # a plane of neighbors has no information along its normal, where A becomes the identity
    trace = B[0, 0] + B[1, 1] + B[2, 2]
    det = (
        B[0, 0] * (B[1, 1] * B[2, 2] - B[1, 2] * B[1, 2])
        - B[0, 1] * (B[0, 1] * B[2, 2] - B[1, 2] * B[0, 2])
        + B[0, 2] * (B[0, 1] * B[1, 2] - B[1, 1] * B[0, 2])
    )
    flatness = max(1.0 - det / (FLAT * trace * trace * trace + 1e-300), 0.0)
    regularization = 0.02 * flatness * trace + 1e-30
    for a in range(3):
        B[a, a] += regularization
        A[a, a] += regularization
    if count < 4:
        A[:] = 0.0
        A[0, 0] = A[1, 1] = A[2, 2] = 1.0
        return
    c00 = B[1, 1] * B[2, 2] - B[1, 2] * B[1, 2]
    c01 = B[0, 2] * B[1, 2] - B[0, 1] * B[2, 2]
    c02 = B[0, 1] * B[1, 2] - B[0, 2] * B[1, 1]
    c11 = B[0, 0] * B[2, 2] - B[0, 2] * B[0, 2]
    c12 = B[0, 1] * B[0, 2] - B[0, 0] * B[1, 2]
    c22 = B[0, 0] * B[1, 1] - B[0, 1] * B[0, 1]
    det = 1.0 / (B[0, 0] * c00 + B[0, 1] * c01 + B[0, 2] * c02)
    for a in range(3):
        u, v, w = A[a, 0], A[a, 1], A[a, 2]
        M[a, 0] = (u * c00 + v * c01 + w * c02) * det
        M[a, 1] = (u * c01 + v * c11 + w * c12) * det
        M[a, 2] = (u * c02 + v * c12 + w * c22) * det
    A[:] = M


@njit_cached(nogil=True, error_model="numpy")
def jacobi(C, Q):
    """Diagonalize the symmetric C (3, 3) in place; the eigenvectors become the columns of Q."""
    Q[:] = 0.0
    Q[0, 0] = Q[1, 1] = Q[2, 2] = 1.0
    for _ in range(12):
        off_diagonal = C[0, 1] ** 2 + C[0, 2] ** 2 + C[1, 2] ** 2
        if off_diagonal < 1e-22 * (C[0, 0] ** 2 + C[1, 1] ** 2 + C[2, 2] ** 2):
            break
        for pair in range(3):
            p = 1 if pair == 2 else 0
            q = 1 if pair == 0 else 2
            if abs(C[p, q]) < 1e-300:
                continue
            theta = 0.5 * (C[q, q] - C[p, p]) / C[p, q]
            t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
            if theta < 0.0:
                t = -t
            c = 1.0 / np.sqrt(t * t + 1.0)
            s = t * c
            for k in range(3):
                u, v = C[k, p], C[k, q]
                C[k, p], C[k, q] = c * u - s * v, s * u + c * v
            for k in range(3):
                u, v = C[p, k], C[q, k]
                C[p, k], C[q, k] = c * u - s * v, s * u + c * v
            for k in range(3):
                u, v = Q[k, p], Q[k, q]
                Q[k, p], Q[k, q] = c * u - s * v, s * u + c * v


@njit_cached(nogil=True, error_model="numpy")
def _stretches(x, rows, row_of, links, spacing, torn, low, high, out):
    """Write the stretches of all particles to out (m, 6)."""
    A, B, M, C = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for p in range(len(x)):
        row = rows[p]
        if links.row[row] >= 0:
            _fit(p, x, links.row[row], row_of, links, spacing[row], torn[row], A, B, M)
        else:
            _edges(p, x, row, row_of, links, spacing[row], torn[row], A)
        for a in range(3):
            for b in range(3):
                C[a, b] = A[a, 0] * A[b, 0] + A[a, 1] * A[b, 1] + A[a, 2] * A[b, 2]
        jacobi(C, B)
        k = 0
        for a in range(3):
            M[a, a] = min(max(np.sqrt(max(C[a, a], 0.0)), low[p]), high[p])
        for a in range(3):
            for b in range(a, 3):
                out[p, k] = (
                    B[a, 0] * M[0, 0] * B[b, 0]
                    + B[a, 1] * M[1, 1] * B[b, 1]
                    + B[a, 2] * M[2, 2] * B[b, 2]
                )
                k += 1
