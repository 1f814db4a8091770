"""Test of which points lie inside a surface mesh, by signed crossings along the axes."""

import numpy as np

from .triangle_mesh import Mesh

_MAX_CROSSINGS = 64  # crossings on one line up to which they are tested one by one
_BATCH = 1 << 18  # crossings of triangles with lines per batch, of some 250 bytes each


def inside(mesh: Mesh, points: np.ndarray, spacing: float) -> np.ndarray:
    """Return which points (n, 3) of a lattice of the given spacing [m] lie inside a placed mesh.

    Along each axis a line through the points counts the signed crossings below each; two of three
    axes must agree, so that a hole in the mesh does not turn a whole line inside out.
    """
    corner = mesh.corners()

    def along(axis: int, points: np.ndarray) -> np.ndarray:
        """Return which points are inside, by lines along an axis."""
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        return _winding(corner[:, :, order], points[:, order], spacing) != 0

    votes, other = along(0, points), along(1, points)
    differ = np.flatnonzero(votes != other)  # elsewhere the third axis cannot matter
    if len(differ):
        votes[differ] = along(2, points[differ])
    return votes


def _winding(corner: np.ndarray, points: np.ndarray, h: float) -> np.ndarray:
    """Return the signed crossings (n,) of the mesh below each point, along the third coordinate.

    points: on a lattice of spacing h in the first two coordinates.
    """
    column = np.floor(points[:, :2] / h).astype(np.int64)
    start = column.min(axis=0)
    size = column.max(axis=0) - start + 1
    # A line exactly through an edge would count twice or never: lines are shifted a little.
    shift = h * np.array([3.1e-6, 7.7e-6])
    low = np.ceil((corner[:, :, :2].min(axis=1) - shift) / h - 0.5).astype(np.int64)
    high = np.floor((corner[:, :, :2].max(axis=1) - shift) / h - 0.5).astype(np.int64)
    low, high = np.maximum(low, start), np.minimum(high, start + size - 1)
    span = np.maximum(high - low + 1, 0)
    count = span[:, 0] * span[:, 1]
    below = np.zeros(len(points), dtype=np.int64)
    columns = _flat(column - start, size)
    # Batches bound the memory: each of many large triangles crosses every line.
    last = np.cumsum(count)
    ends = np.searchsorted(last, np.arange(_BATCH, last[-1] + _BATCH, _BATCH), "right")
    for part in np.split(np.arange(len(corner)), np.unique(np.minimum(ends, len(corner)))):
        tri = np.repeat(part, count[part])
        nth = np.arange(len(tri)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        cell = low[tri] + np.stack([nth // span[tri, 1], nth % span[tri, 1]], axis=1)
        hit, height, sign = _hits(corner[tri], (cell + 0.5) * h + shift)
        below += _crossings_below(_flat(cell[hit] - start, size), height, sign, columns, points)
    return below


def _hits(corner: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which triangles (n, 3, 3) their lines (n, 2) along the third axis meet."""
    a, b, c = (corner[:, k] for k in range(3))
    u, v, w = (_area(p, q, line) for p, q in ((b, c), (c, a), (a, b)))
    twice = u + v + w
    hit = (((u > 0) & (v > 0) & (w > 0)) | ((u < 0) & (v < 0) & (w < 0))) & (twice != 0)
    u, v, w, twice = u[hit], v[hit], w[hit], twice[hit]
    return hit, (u * a[hit, 2] + v * b[hit, 2] + w * c[hit, 2]) / twice, np.sign(twice)


def _area(p: np.ndarray, q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return twice the signed area of triangles p, q, x in the plane of the first two axes."""
    return (p[:, 0] - x[:, 0]) * (q[:, 1] - x[:, 1]) - (p[:, 1] - x[:, 1]) * (q[:, 0] - x[:, 0])


def _flat(cell: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the flat index of cells (n, 2)."""
    return cell[:, 0] * size[1] + cell[:, 1]


def _crossings_below(lines, heights, signs, columns, points) -> np.ndarray:
    """Return for each point the sum of `signs` of the lower crossings on its line."""
    if not len(lines):
        return np.zeros(len(points), dtype=np.int64)
    count = np.bincount(lines, minlength=columns.max() + 1)
    if count.max() > _MAX_CROSSINGS:
        return _crossings_below_sorted(lines, heights, signs, columns, points)
    order = np.lexsort((heights, lines))
    z, sign = heights[order], signs[order].astype(np.int64)
    first = np.cumsum(count) - count
    out = np.zeros(len(points), dtype=np.int64)
    rows = np.flatnonzero(count[columns])  # points above all crossings tested so far
    crossing, remaining = first[columns[rows]], count[columns[rows]]
    for _ in range(count.max()):
        below = z[crossing] <= points[rows, 2]
        out[rows] += np.where(below, sign[crossing], 0)
        more = below & (remaining > 1)
        rows, crossing, remaining = rows[more], crossing[more] + 1, remaining[more] - 1
    return out


def _crossings_below_sorted(lines, heights, signs, columns, points) -> np.ndarray:
    """Return `_crossings_below` for lines with any number of crossings."""
    line = np.concatenate([lines, columns])
    z = np.concatenate([heights, points[:, 2]])
    sign = np.concatenate([signs, np.zeros(len(columns))]).astype(np.int64)
    order = np.lexsort((z, line))
    total = np.cumsum(sign[order])
    first = np.searchsorted(line[order], line[order], side="left")
    before = np.concatenate([[0], total])[first]  # sums of earlier lines
    out = np.empty(len(line), dtype=np.int64)
    out[order] = total - before
    return out[len(lines) :]
