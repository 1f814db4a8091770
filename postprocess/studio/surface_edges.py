"""Flat Gaussians of a surface, cut at its edges: their tails would stand out beyond them.

The discs near an edge know its other face by the discs there. The part of a disc's width beyond
that face is cut away, which moves its center inward and makes it narrower.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

NEIGHBORS = 14  # discs among which those of another face are searched
REACH = 4.0  # [standard deviations] distance of the farthest of them
WIDTH = 2.0  # [standard deviations] half width of a disc that counts as covered
EDGE_COSINE = 0.85  # [-] between the normals of two faces, below which they meet at an edge
TURN = np.sqrt(2.0 * (1.0 - EDGE_COSINE) / 3.0)  # [-] least change of some component of a normal
LEAST_WIDTH = 0.1  # [-] least width that is left of a disc


def cut_at_edges(
    x: np.ndarray, normal: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (n, 3) [m] and covariances (n, 6) [m2] of discs cut at convex edges.

    Args:
        x: Centers, shape (n, 3) [m].
        normal: Outward unit normals, shape (n, 3).
        cov: Covariances, shape (n, 6) [m2].
    """
    from scipy.spatial import cKDTree

    shift, cut = np.zeros_like(x), np.array(cov, dtype=np.float64)
    reach = REACH * np.sqrt(0.5 * np.median(cut[:, (0, 3, 5)].sum(axis=1))) if len(x) else 0.0
    rows = _rows_near_edges(x, normal, reach) if len(x) > 1 and reach > 0 else np.zeros(0, int)
    if len(rows):
        count = min(NEIGHBORS + 1, len(x))
        nearest = cKDTree(x).query(
            x[rows], k=np.arange(2, count + 1), distance_upper_bound=reach
        )[1]  # fmt: skip
        nearest = np.where(nearest < len(x), nearest, rows[:, None])  # itself, where there is none
        _cut(np.ascontiguousarray(x), np.ascontiguousarray(normal), rows, nearest, shift, cut)
    return shift, cut


def _rows_near_edges(x: np.ndarray, normal: np.ndarray, reach: float) -> np.ndarray:
    """Return the rows (m,) of discs in whose surroundings the normals differ as at an edge.

    Args:
        x: Centers, shape (n, 3) [m].
        normal: Unit normals, shape (n, 3).
        reach: Distance up to which they are compared, and more [m].
    """
    size = max(reach, 1e-6 * float(np.ptp(x, axis=0).max()))  # for keys of 64 bits
    cell = np.floor((x - x.min(axis=0)) / size).astype(np.int64) + 1
    shape = cell.max(axis=0) + 2
    key = np.ravel_multi_index(tuple(cell.T), shape)
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.append(True, np.diff(key[order]) > 0))
    keys = key[order[starts]]
    low, high = (f.reduceat(normal[order], starts) for f in (np.minimum, np.maximum))
    lowest, highest = low.copy(), high.copy()
    for a, b, c in np.indices((3, 3, 3)).reshape(3, -1).T - 1:
        neighbor_keys = keys + (a * shape[1] + b) * shape[2] + c
        match = np.minimum(np.searchsorted(keys, neighbor_keys), len(keys) - 1)
        rows = np.flatnonzero(keys[match] == neighbor_keys)
        lowest[rows] = np.minimum(lowest[rows], low[match[rows]])
        highest[rows] = np.maximum(highest[rows], high[match[rows]])
    turns = (highest - lowest >= TURN).any(axis=1)
    return np.sort(order[np.repeat(turns, np.diff(np.append(starts, len(x))))])


@njit_cached(nogil=True, error_model="numpy")
def _cut(x, normal, rows, nearest, shift, cov):
    """Cut some discs along the two directions in which edges are closest.

    Args:
        x, normal: Centers [m] and normals, shape (n, 3).
        rows: Rows of these discs, shape (m,).
        nearest: Rows of their neighbors, shape (m, k).
        shift: (out) Displacements, shape (n, 3) [m].
        cov: Covariances, shape (n, 6) [m2] (in/out).
    """
    u, first = np.empty(3), np.empty(3)
    for m in range(len(rows)):
        p, neighbors = rows[m], nearest[m]
        for axis in range(2):
            if not _closest_edge(x, normal, neighbors, p, axis, first, u):
                break
            sd = np.sqrt(max(_spread(cov[p], u), 0.0))
            upper = lower = WIDTH * sd
            for q in neighbors:
                e, side = _distance(x, normal, p, q, u)
                if side > 0.7:
                    upper = min(upper, e)
                elif side < -0.7:
                    lower = min(lower, e)
            share = max(0.5 * (upper + lower) / max(WIDTH * sd, 1e-300), LEAST_WIDTH)
            if share < 1.0:
                for c in range(3):
                    shift[p, c] += 0.5 * (upper - lower) * u[c]
                _narrow(cov[p], u, share)
            first[:] = u


@njit_cached(nogil=True, error_model="numpy")
def _closest_edge(x, normal, neighbors, p, axis, first, u):
    """Write the unit direction in disc p to its closest edge to u (3,); return whether it has one.

    The second one, of axis 1, is at right angles to the first.
    """
    best, away = np.inf, np.empty(3)
    for q in neighbors:
        e, s = _towards(x, normal, p, q, away)
        if e < 0.0 or e >= best:
            continue
        if axis == 1:
            dot = away[0] * first[0] + away[1] * first[1] + away[2] * first[2]
            if abs(dot) > 0.7:
                continue
            size = np.sqrt(1.0 - dot * dot)
            for m in range(3):
                away[m] = (away[m] - dot * first[m]) / size
        best = e
        u[:] = away
    return best < np.inf


@njit_cached(nogil=True, error_model="numpy")
def _towards(x, normal, p, q, away):
    """Return the distance [m] in disc p to the plane of disc q, and the sine between them.

    The distance is -1 where they do not meet at a convex edge. away: (3,) out, the direction.
    """
    c = h = g = 0.0
    for m in range(3):
        c += normal[p, m] * normal[q, m]
        h += normal[q, m] * (x[q, m] - x[p, m])
        g += normal[p, m] * (x[p, m] - x[q, m])
    if c > EDGE_COSINE or c < -EDGE_COSINE or h < 0.0 or g < 0.0:
        return -1.0, 0.0
    s = np.sqrt(1.0 - c * c)
    for m in range(3):
        away[m] = (normal[q, m] - c * normal[p, m]) / s
    return h / s, s


@njit_cached(nogil=True, error_model="numpy")
def _distance(x, normal, p, q, u):
    """Return the distance to an edge [m], and the cosine between its direction and u (3,)."""
    away = np.empty(3)
    e, s = _towards(x, normal, p, q, away)
    if e < 0.0:
        return 0.0, 0.0
    return e, away[0] * u[0] + away[1] * u[1] + away[2] * u[2]


@njit_cached(nogil=True, error_model="numpy")
def _times(c, u, out):
    """Write the product of a covariance (6,) and a vector (3,) to out (3,)."""
    out[0] = c[0] * u[0] + c[1] * u[1] + c[2] * u[2]
    out[1] = c[1] * u[0] + c[3] * u[1] + c[4] * u[2]
    out[2] = c[2] * u[0] + c[4] * u[1] + c[5] * u[2]


@njit_cached(nogil=True, error_model="numpy")
def _spread(c, u):
    """Return the variance [m2] of a covariance (6,) along a unit vector (3,)."""
    v = np.empty(3)
    _times(c, u, v)
    return v[0] * u[0] + v[1] * u[1] + v[2] * u[2]


@njit_cached(nogil=True, error_model="numpy")
def _narrow(c, u, share):
    """Scale the width of a covariance (6,) along a unit vector (3,) by a factor below 1."""
    v = np.empty(3)
    _times(c, u, v)
    f = (1.0 - share * share) / max(v[0] * u[0] + v[1] * u[1] + v[2] * u[2], 1e-300)
    c[0] -= f * v[0] * v[0]
    c[1] -= f * v[0] * v[1]
    c[2] -= f * v[0] * v[2]
    c[3] -= f * v[1] * v[1]
    c[4] -= f * v[1] * v[2]
    c[5] -= f * v[2] * v[2]
