"""Search for surface points of free rigid bodies that may touch: pairs of bodies, then balls.

The search leaves out what cannot touch, and nothing else: contacts are the same as without it.
Pairs of boxes come from sort and sweep along an axis. The points of a body are in balls of two
sizes. Distances on a lattice change by at most a known slope, so the distance at the middle of a
ball bounds those of its points.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.sdf_sampling import SampledSdf, distance_from_collider
from vgmpi.runtime.jit import array_function, device_function, kernel

from .surface_points import SurfacePoints, dot

BALL_CELLS = 2.0, 12.0  # [cells] edges of the cubes whose points are in a ball
TIGHT_CELLS = 0.35  # [cells] reach up to which the tight boxes of colliders hold
MARGIN_CELLS = 1e-6  # [cells] far above rounding errors


class Balls(NamedTuple):
    """Balls around parts of a row of points or balls, in the body's axes from its center."""

    first: np.ndarray  # (n + 1,) first part of each ball
    center: np.ndarray  # (n, 3) [m]
    radius: np.ndarray  # (n,) [m]


class ContactSearch(NamedTuple):
    """Bounds of the surface points of free bodies and of the distances of colliders."""

    first: np.ndarray  # (bodies + 1,) first large ball of each body
    large: Balls  # parts: small balls
    small: Balls  # parts: rows of `order`
    order: np.ndarray  # (points,) numbers of surface points
    points_low: np.ndarray  # (bodies, 3) [m] corners of a box of the points, from the center
    points_high: np.ndarray  # (bodies, 3) [m]
    slope: np.ndarray  # (colliders,) [-] bound of the change of distance per length
    low: np.ndarray  # (colliders, 3) [m] box outside which distances are above TIGHT_CELLS
    high: np.ndarray  # (colliders, 3) [m]


def contact_search(surface: SurfacePoints, movers: SampledSdf, dx: float) -> ContactSearch:
    """Return the search for the surface points of bodies and for sampled colliders.

    Args:
        surface: Points of the bodies.
        movers: Colliders.
        dx: Cell size [m].
    """
    count = len(surface.first) - 1
    starts, sizes = surface.first[:-1], np.diff(surface.first)
    points_low = np.minimum.reduceat(surface.place, starts)
    owner = np.repeat(np.arange(count), sizes)
    corner = np.repeat(points_low, sizes, axis=0)
    cubes = [((surface.place - corner) / (edge * dx)).astype(np.int64) for edge in BALL_CELLS]
    keys = (*cubes[0].T, *cubes[1].T, owner)
    order = np.lexsort(keys)
    small_first = _first_of_groups(np.stack(keys, 1)[order])
    small = _balls(surface.place[order], small_first)
    large_keys = np.stack(keys[3:], 1)[order][small_first[:-1]]
    large_first = _first_of_groups(large_keys)
    large = _balls(surface.place[order], small_first[large_first])._replace(first=large_first)
    first = np.searchsorted(large_keys[large_first[:-1], 3], np.arange(count + 1))
    low, high, slope = _tight_boxes(movers, dx)
    return ContactSearch(
        first, large, small, order, points_low, np.maximum.reduceat(surface.place, starts),
        slope, low, high,
    )  # fmt: skip


def search_without_bounds(search: ContactSearch) -> ContactSearch:
    """Return a search that leaves nothing out, for tests."""
    everywhere = np.full_like(search.large.radius, np.inf)
    return search._replace(
        large=search.large._replace(radius=everywhere),
        small=search.small._replace(radius=np.full_like(search.small.radius, np.inf)),
        points_low=np.full_like(search.points_low, -1e9),
        points_high=np.full_like(search.points_high, 1e9),
    )


def _first_of_groups(keys: np.ndarray) -> np.ndarray:
    """Return the first row of each group of equal rows (n, c), and the number of rows."""
    is_new = np.ones(len(keys), bool)
    is_new[1:] = (keys[1:] != keys[:-1]).any(1)
    return np.append(np.flatnonzero(is_new), len(keys))


def _balls(points: np.ndarray, first: np.ndarray) -> Balls:
    """Return balls around groups of consecutive points (n, 3) [m]."""
    starts, sizes = first[:-1], np.diff(first)
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    center = 0.5 * (low + high)
    offset = ((points - np.repeat(center, sizes, axis=0)) ** 2).sum(1)
    return Balls(first, center, np.sqrt(np.maximum.reduceat(offset, starts)))


def _tight_boxes(movers: SampledSdf, dx: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lower and upper corners, (m, 3) [m], and slopes (m,) of sampled distances."""
    count = len(movers.first)
    low, high, slope = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for m in range(count):
        shape, begin = movers.shape[m], movers.first[m]
        values = movers.values[begin : begin + np.prod(shape)].reshape(shape)
        slope[m] = _max_outer_slope(values) / movers.spacing
        for a in range(3):
            minima = values.min(axis=tuple(b for b in range(3) if b != a))
            first, last = _range_below(minima, TIGHT_CELLS * dx)
            low[m, a] = movers.start[m, a] + movers.spacing * first
            high[m, a] = movers.start[m, a] + movers.spacing * last
    return low, high, slope


def _range_below(minima: np.ndarray, limit: float) -> tuple[float, float]:
    """Return the first and last place at which numbers on a lattice are below a limit.

    They are interpolated linearly. If none is below it, the range is that of the lattice.
    """
    rows = np.flatnonzero(minima <= limit)
    if not len(rows):
        return 0.0, len(minima) - 1.0
    first, last = float(rows[0]), float(rows[-1])
    if rows[0] > 0:
        a, b = minima[rows[0]], minima[rows[0] - 1]
        first -= (limit - a) / (b - a)
    if rows[-1] < len(minima) - 1:
        a, b = minima[rows[-1]], minima[rows[-1] + 1]
        last += (limit - a) / (b - a)
    return first, last


@kernel
def _max_outer_slope(values):
    """Return a bound of the gradient of values (nx, ny, nz) interpolated on a unit lattice.

    Cells without a positive value do not count: outside a surface no way passes them.
    """
    max_square = 0.0
    nx, ny, nz = values.shape
    for i in range(nx - 1):
        for j in range(ny - 1):
            for k in range(nz - 1):
                x = y = z = top = 0.0
                for a in range(2):
                    for b in range(2):
                        top = max(top, values[i, j + a, k + b], values[i + 1, j + a, k + b])
                        x = max(x, abs(values[i + 1, j + a, k + b] - values[i, j + a, k + b]))
                        y = max(y, abs(values[i + a, j + 1, k + b] - values[i + a, j, k + b]))
                        z = max(z, abs(values[i + a, j + b, k + 1] - values[i + a, j + b, k]))
                square = x * x + y * y + z * z
                if top > 0.0 and not square <= max_square:
                    max_square = square
    return np.sqrt(max_square)


@device_function
def _store_box(low, high, rotation, shift, margin, box):
    """Store the box in the domain's axes of a turned, shifted one.

    Args:
        low, high: Corners, shape (3,) [m].
        rotation, shift: Rotation (3, 3), then shift (3,) [m].
        margin: Width that is added on all sides [m].
        box: Corners (out), shape (2, 3).
    """
    for c in range(3):
        center, half = shift[c], margin
        for a in range(3):
            center += rotation[c, a] * 0.5 * (low[a] + high[a])
            half += abs(rotation[c, a]) * 0.5 * (high[a] - low[a])
        box[0, c], box[1, c] = center - half, center + half


@array_function
def _place_boxes(search, bodies, movers, number_of, reach, dx, boxes):
    """Store boxes in the domain's axes: of each collider's distances, and of its points [m].

    Args:
        search, bodies, movers, number_of, reach, dx: See `find_pairs`.
        boxes: Lower and upper corners of both (out), shape (colliders, 2, 2, 3).
    """
    shift, margin = np.zeros(3), MARGIN_CELLS * dx
    for m in range(len(number_of)):
        r, about = movers.rotation[m], movers.about[m]
        low, high = search.low[m], search.high[m]
        if reach > 0.9 * TIGHT_CELLS * dx:
            low = movers.start[m]
            high = low + movers.spacing * (movers.shape[m] - 1)
        for c in range(3):
            shift[c] = about[c] + movers.move[m, c] - dot(r[c], about)
        _store_box(low, high, r, shift, margin, boxes[m, 0])
        k = number_of[m]
        if k >= 0:
            _store_box(
                search.points_low[k], search.points_high[k], bodies.rotations[k], bodies.x[k],
                margin, boxes[m, 1],
            )  # fmt: skip
        else:
            boxes[m, 1] = boxes[m, 0]


@device_function
def _overlap(a, b):
    """Return whether two boxes (2, 3) have points in common."""
    for c in range(3):
        if a[0, c] > b[1, c] or b[0, c] > a[1, c]:
            return False
    return True


@device_function
def _widest_axis(boxes):
    """Return the axis along which boxes (m, 2, 2, 3) are spread most."""
    axis, widest = 0, -1.0
    for a in range(3):
        mean, square = 0.0, 0.0
        for m in range(len(boxes)):
            middle = 0.5 * (boxes[m, 1, 0, a] + boxes[m, 1, 1, a])
            mean += middle / len(boxes)
            square += middle * middle / len(boxes)
        if square - mean * mean > widest:
            axis, widest = a, square - mean * mean
    return axis


@kernel
def find_pairs(search, bodies, movers, number_of, reach, dx):
    """Return the pairs of bodies and colliders that may touch, in order.

    Args:
        search: ContactSearch.
        bodies: BodyTable.
        movers: Sampled colliders, SampledSdf.
        number_of: Number of the free body of each collider, -1 if it is not free.
        reach: Gap up to which points may touch [m].
        dx: Cell size [m].

    Returns:
        A number k m + c for each pair of body k and collider c among m, ascending, shape (n,).
    """
    count = len(number_of)
    boxes = np.zeros((count, 2, 2, 3))
    _place_boxes(search, bodies, movers, number_of, reach, dx, boxes)
    axis = _widest_axis(boxes)
    begin = np.minimum(boxes[:, 0, 0, axis], boxes[:, 1, 0, axis])
    end = np.maximum(boxes[:, 0, 1, axis], boxes[:, 1, 1, axis])
    order = np.argsort(begin)
    pairs, total = np.zeros(4 * count, np.int64), 0
    for i in range(count):
        m = order[i]
        for j in range(i + 1, count):
            n = order[j]
            if begin[n] > end[m]:
                break
            if total + 2 > len(pairs):
                longer = np.zeros(2 * len(pairs) + 2, np.int64)
                longer[:total] = pairs[:total]
                pairs = longer
            if number_of[m] >= 0 and _overlap(boxes[m, 1], boxes[n, 0]):
                pairs[total] = number_of[m] * count + n
                total += 1
            if number_of[n] >= 0 and _overlap(boxes[n, 1], boxes[m, 0]):
                pairs[total] = number_of[n] * count + m
                total += 1
    return np.sort(pairs[:total])


@device_function
def _is_beyond(movers, m, slope, place, radius, reach, scratch):
    """Return whether no point of a ball is within reach of a collider.

    Args:
        movers: SampledSdf.
        m: Number of the collider.
        slope: Bound of the change of its distance per length.
        place, radius: Ball, shape (3,) [m] and [m].
        reach: Gap up to which points may touch [m].
        scratch: Arrays of shapes (3,), (4,), (3,) and (3,).
    """
    own, sample, inside = scratch[0], scratch[1], scratch[2]
    distance = distance_from_collider(movers, m, place, own, sample)
    if distance < np.inf:
        return distance > reach + slope * radius
    # the distance is known on a lattice only: take it from the nearest point there
    square, r = 0.0, movers.rotation[m]
    for c in range(3):
        low, extent = movers.start[m, c], movers.spacing * (movers.shape[m, c] - 1)
        nearest = min(max(own[c], low + 1e-9 * extent), low + (1.0 - 1e-9) * extent)
        square += (nearest - own[c]) ** 2
        own[c] = nearest - movers.about[m, c]
    if square > radius * radius:
        return True
    for c in range(3):
        inside[c] = dot(r[c], own) + movers.about[m, c] + movers.move[m, c]
    return distance_from_collider(movers, m, inside, own, sample) > reach + slope * radius


@array_function
def points_close_to_collider(search, bodies, k, movers, m, reach, dx, scratch, out):
    """Store the points of a body that may be within reach of a collider, in order.

    Args:
        search: ContactSearch.
        bodies: BodyTable.
        k: Number of the body.
        movers: Sampled colliders, SampledSdf.
        m: Number of the collider.
        reach: Gap up to which points may touch [m].
        dx: Cell size [m].
        scratch: Arrays of shapes (3,), (4,), (3,) and (3,).
        out: Numbers of the points (out).

    Returns:
        Their number.
    """
    x, rotation, count = scratch[3], bodies.rotations[k], 0
    margin = MARGIN_CELLS * dx
    slope, large, small = search.slope[m], search.large, search.small
    for a in range(search.first[k], search.first[k + 1]):
        for c in range(3):
            x[c] = bodies.x[k, c] + dot(rotation[c], large.center[a])
        if _is_beyond(movers, m, slope, x, large.radius[a] + margin, reach, scratch):
            continue
        for b in range(large.first[a], large.first[a + 1]):
            for c in range(3):
                x[c] = bodies.x[k, c] + dot(rotation[c], small.center[b])
            if _is_beyond(movers, m, slope, x, small.radius[b] + margin, reach, scratch):
                continue
            for q in range(small.first[b], small.first[b + 1]):
                out[count] = search.order[q]
                count += 1
    out[:count].sort()
    return count


@array_function
def points_close_to_wall(search, k, row, start, reach, dx, out):
    """Store the points of a body that may be within reach of a wall, in order.

    Args:
        search: ContactSearch.
        k: Number of the body.
        row: Inward normal of the wall in the body's axes, shape (3,).
        start: Distance of the body's center from the wall [m].
        reach: Gap up to which points may touch [m].
        dx: Cell size [m].
        out: Numbers of the points (out).

    Returns:
        Their number.
    """
    large, small, count = search.large, search.small, 0
    limit = reach + MARGIN_CELLS * dx
    for a in range(search.first[k], search.first[k + 1]):
        if start + dot(row, large.center[a]) - large.radius[a] > limit:
            continue
        for b in range(large.first[a], large.first[a + 1]):
            if start + dot(row, small.center[b]) - small.radius[b] > limit:
                continue
            for q in range(small.first[b], small.first[b + 1]):
                out[count] = search.order[q]
                count += 1
    out[:count].sort()
    return count
