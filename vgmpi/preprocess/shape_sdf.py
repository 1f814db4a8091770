"""Support and color of shapes, and the lattice of particles inside.

Lengths are in the shape's own coordinates [m].
"""

import functools
from collections.abc import Callable, Iterator

import numpy as np

from vgmpi.gaussians.shape_distance import distance
from vgmpi.scene.shapes import Shape

Judge = Callable[[np.ndarray], np.ndarray]  # points (n, 3) -> bool (n,)

# Lattice points are judged this share of a spacing up from where they lie, so that a face that
# runs exactly through a layer of points takes the layer at the low side and leaves the one at the
# high side, whatever rounding says.
TIE = 1e-6
BLOCK = 16  # points along an edge of the cubes that are tested as a whole
_POINTS_PER_BATCH = 500_000  # points tested together
COMPOUND = ("union", "difference", "intersection")  # shapes made of shapes
SEARCH_POINTS = 31  # along each axis of the grid that searches the extent of a compound shape
SEARCH_TOLERANCE = 1e-9  # [-] of the extent


def contains(shape: Shape, points: np.ndarray, spacing: float) -> np.ndarray:
    """Return which points (n, 3) [m] of a lattice are inside a shape, shape (n,).

    A face that runs through a layer of points takes the layer at the low side, as everywhere.

    Args:
        shape: Shape in the coordinates of the points.
        points: Points, shape (n, 3) [m].
        spacing: Spacing of the lattice [m].
    """
    return distance(shape, points + TIE * spacing) < 0


def support(shape: Shape, direction: np.ndarray) -> float:
    """Return the largest x . direction over the shape's points x (support function).

    For a blended union it is that of its parts (see `blend_overhang`). For a difference and an
    intersection it is searched to about 1e-9 of the size; what sticks out there must be wider than
    a thirtieth of the shape.
    """
    form = getattr(shape, shape.form)
    d = np.asarray(direction, dtype=float)
    match shape.form:
        case "box":
            return float(np.maximum(d * form[0], d * form[1]).sum())
        case "sphere":
            return float(d @ form.center + form.radius * np.linalg.norm(d))
        case "ellipsoid":
            return float(d @ form.center + np.linalg.norm(d * form.radii))
        case "cylinder":
            a, b = np.asarray(form.endpoints)
            axis = (b - a) / np.linalg.norm(b - a)
            return float(max(d @ a, d @ b) + form.radius * np.linalg.norm(d - (d @ axis) * axis))
        case "capsule":
            return float(
                max(d @ np.asarray(e) for e in form.endpoints) + form.radius * np.linalg.norm(d)
            )
        case "cone":
            a, b = np.asarray(form.endpoints)
            axis = (b - a) / max(float(np.linalg.norm(b - a)), 1e-300)
            wide = np.linalg.norm(d - (d @ axis) * axis)
            return float(max(d @ a + form.radii[0] * wide, d @ b + form.radii[1] * wide))
        case "torus":
            flat = np.linalg.norm(d - (d @ form.axis) * np.asarray(form.axis))
            return float(
                d @ form.center + form.major_radius * flat + form.minor_radius * np.linalg.norm(d)
            )
        case "union":
            return max(support(part, d) for part in form)
    return _search_support(shape, tuple(d.tolist()))


@functools.lru_cache(maxsize=1024)
def _search_support(shape: Shape, direction: tuple[float, float, float]) -> float:
    """Return the support of a difference or an intersection, by ever finer grids of its top."""
    size = float(np.linalg.norm(direction))
    third = np.array(direction) / size
    first = np.cross(third, np.eye(3)[np.argmin(np.abs(third))])
    axes = np.stack([first / np.linalg.norm(first), np.cross(third, first), third])
    axes[1] /= np.linalg.norm(axes[1])
    high = np.array([_bound(shape, axis) for axis in axes])
    low = -np.array([_bound(shape, -axis) for axis in axes])
    bound, extent = high[2], high[2] - low[2]
    steps = np.stack(np.meshgrid(*[np.linspace(0, 1, SEARCH_POINTS)] * 3, indexing="ij"), -1)
    while high[2] - low[2] > SEARCH_TOLERANCE * extent:
        points = (low + steps * (high - low)).reshape(-1, 3)
        inside = (distance(shape, points @ axes) < 0).reshape(steps.shape[:3])
        layers = np.flatnonzero(inside.any(axis=(0, 1)))
        if not len(layers):
            break
        top, spacing = layers[-1], (high - low) / (SEARCH_POINTS - 1)
        columns = np.argwhere(inside[:, :, top])
        window = low[:2] + columns.min(0) * spacing[:2], low[:2] + columns.max(0) * spacing[:2]
        level = low[2] + top * spacing[2]
        low = np.array([*(window[0] - spacing[:2]), level])
        high = np.array([*(window[1] + spacing[:2]), min(level + spacing[2], bound)])
    return size * float(high[2])


def _bound(shape: Shape, direction: np.ndarray) -> float:
    """Return an upper bound of the support in a unit direction, without a search."""
    parts = getattr(shape, shape.form)
    if shape.form == "union":
        return max(_bound(part, direction) for part in parts) + blend_overhang(shape)
    if shape.form == "difference":
        return _bound(parts[0], direction)
    if shape.form == "intersection":
        return min(_bound(part, direction) for part in parts)
    return support(shape, direction)


def blend_overhang(shape: Shape) -> float:
    """Return the distance [m] by which blending may push the shape beyond its support."""
    if shape.form != "union":
        return 0.0  # the support of a difference or an intersection is that of its blended parts
    parts = shape.union
    assert parts is not None
    return (
        max(blend_overhang(part) for part in parts)
        + (len(parts) - 1) * (shape.blend_radius or 0.0) / 4
    )


def is_lipschitz(shape: Shape) -> bool:
    """Return whether `distance` changes by at most the distance of two points.

    This does not hold near an ellipsoid.
    """
    parts = getattr(shape, shape.form) if shape.form in COMPOUND else ()
    return shape.form != "ellipsoid" and all(is_lipschitz(part) for part in parts)


def colors(shape: Shape, points: np.ndarray, default: tuple) -> np.ndarray:
    """Return the color (n, 3) of `points`: that of the first part around them, or `default`."""
    color = shape.color or default
    first_of = shape.difference or shape.intersection
    if first_of is not None:
        return colors(first_of[0], points, color)
    out = np.tile(np.asarray(color, dtype=float), (len(points), 1))
    if shape.union is not None:
        holder, nearest = np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
        for k, part in enumerate(shape.union):
            # Points in no part (scenery's skin, rounding) take the nearest.
            depth = distance(part, points)
            nearer = (nearest > 0) & (depth < nearest)
            holder[nearer], nearest[nearer] = k, depth[nearer]
        for k, part in enumerate(shape.union):
            rows = holder == k
            out[rows] = colors(part, points[rows], color)
    return out


def lattice(
    inside: Judge, low: np.ndarray, high: np.ndarray, spacing: float, is_empty: Judge | None = None
) -> np.ndarray:
    """Return the lattice points (n, 3), cell centers (i + 1/2) spacing, for which `inside` is true.

    Args:
        inside: Called with points (m, 3), few at a time so that memory stays bounded; returns (m,)
            bool.
        low: Lower corner of the searched region, shape (3,) [m].
        high: Upper corner of the searched region, shape (3,) [m].
        spacing: Lattice spacing [m].
        is_empty: Called with the centers (b, 3) of cubes of BLOCK points; whether `inside` is true
            of no point in each, (b,) bool. These cubes are not searched.
    """
    return np.concatenate([np.empty((0, 3)), *lattice_chunks(inside, low, high, spacing, is_empty)])


def lattice_chunks(
    inside: Judge, low: np.ndarray, high: np.ndarray, spacing: float, is_empty: Judge | None = None
) -> Iterator[np.ndarray]:
    """Yield the points of `lattice` in chunks, in order.

    Args:
        inside: See `lattice`.
        low: See `lattice`.
        high: See `lattice`.
        spacing: See `lattice`.
        is_empty: See `lattice`.
    """
    start, stop = _ends(low, high, spacing)
    if is_empty is None:
        for index in _boxes(start, stop, np.array([1, 1, 1]), _POINTS_PER_BATCH):
            points = (index + 0.5) * spacing
            yield points[inside(points + TIE * spacing)]
        return
    cube = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    size = stop - start
    for first in range(
        start[0], stop[0], BLOCK
    ):  # the points of a layer of cubes are sorted together
        layer = [np.empty((0, 3), dtype=np.int64)]
        corner = np.array([first, start[1], start[2]])
        for cubes in _boxes(
            corner, np.array([first + 1, *stop[1:]]), np.array([BLOCK] * 3), _POINTS_PER_BATCH
        ):
            centers = (cubes + BLOCK / 2 + TIE) * spacing
            cubes = cubes[~is_empty(centers)]
            for first_cube in range(0, len(cubes), _POINTS_PER_BATCH // BLOCK**3):
                chunk = cubes[first_cube : first_cube + _POINTS_PER_BATCH // BLOCK**3]
                index = (chunk[:, None] + cube).reshape(-1, 3)
                index = index[(index < stop).all(axis=1)]
                layer.append(index[inside((index + 0.5) * spacing + TIE * spacing)])
        index = np.concatenate(layer)
        key = (index - start) @ np.array([size[1] * size[2], size[2], 1])
        yield (index[np.argsort(key)] + 0.5) * spacing


def prefer_block_search(low: np.ndarray, high: np.ndarray, spacing: float) -> bool:
    """Return whether the region is so wide that testing cubes of points first saves time."""
    return BLOCK * lattice_size(low[1:], high[1:], spacing) >= _POINTS_PER_BATCH


def lattice_size(low: np.ndarray, high: np.ndarray, spacing: float) -> float:
    """Return the approximate number of lattice points in the region that `lattice` searches."""
    return float(np.prod(np.ceil((np.asarray(high) - low) / spacing) + 2.0))


def _ends(low, high, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (3,) of the first lattice point in a region, and of the one after the last."""
    start = np.floor(np.asarray(low) / spacing).astype(np.int64) - 1
    return start, np.ceil(np.asarray(high) / spacing).astype(np.int64) + 1


def _boxes(start, stop, step, limit: int) -> Iterator[np.ndarray]:
    """Yield indices (m, 3) from start to stop in steps, in order, about `limit` at a time."""
    x, y, z = (range(*map(int, ends)) for ends in zip(start, stop, step, strict=True))
    nz = min(len(z), limit)
    ny = min(len(y), max(1, limit // max(1, nz))) if nz == len(z) else 1
    nx = max(1, limit // max(1, nz * ny)) if ny == len(y) else 1
    for i in range(0, len(x), nx):
        for j in range(0, len(y), max(1, ny)):
            for k in range(0, len(z), max(1, nz)):
                axes = (x[i : i + nx], y[j : j + ny], z[k : k + nz])
                yield np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
