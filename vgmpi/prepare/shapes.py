"""Shapes as solids: signed distance, reach and colour of any point; the lattice of particles.

Distances are in the shape's own coordinates [m], negative inside.
"""

from collections.abc import Callable, Iterator

import numpy as np

from vgmpi.scene.forms import Cone, Rod, Shape, Torus

Judge = Callable[[np.ndarray], np.ndarray]  # of points (n, 3), bool (n,)

# Lattice points are judged this share of a spacing up from where they lie, so that a face that
# runs exactly through a layer of points takes the layer at the low side and leaves the one at the
# high side, whatever rounding says.
TIE = 1e-6
BLOCK = 16  # points along an edge of the cubes that are looked at as a whole
_MOST = 500_000  # points looked at together


def distance(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Signed distance (n,) of `points` (n, 3) to the shape's surface.

    Exact for box, sphere, cylinder, capsule, cone and torus; first order near an ellipsoid; a
    bound on the true distance for unions from inside, blended ones and differences (Quilez 2008).
    """
    form = getattr(shape, shape.form)
    match shape.form:
        case "box":
            low, high = np.asarray(form)
            return _from_box(np.abs(points - (low + high) / 2) - (high - low) / 2)
        case "sphere":
            return _length(points - np.asarray(form.center)) - form.radius
        case "ellipsoid":
            return _from_ellipsoid(points - np.asarray(form.center), np.asarray(form.radii))
        case "cylinder":
            return _from_cylinder(form, points)
        case "capsule":
            along, across, length = _rod_coordinates(form, points)
            beyond = along - np.clip(along, 0.0, length)
            return np.hypot(beyond, across) - form.radius
        case "cone":
            return _from_cone(form, points)
        case "torus":
            along, across = _about_axis(form, points)
            return np.hypot(across - form.radius, along) - form.tube
        case "union":
            return _union((distance(part, points) for part in form), shape.blend)
    out = distance(form[0], points)
    for part in form[1:]:  # one after the other: there may be hundreds
        out = np.maximum(out, -distance(part, points))
    return out


def reach(shape: Shape, direction: np.ndarray) -> float:
    """Largest x . direction over the shape's points x; of a difference: over its first part, of a
    blended union: over its parts (see `bulge`)."""
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
            a, b = np.asarray(form.ends)
            axis = (b - a) / np.linalg.norm(b - a)
            return float(max(d @ a, d @ b) + form.radius * np.linalg.norm(d - (d @ axis) * axis))
        case "capsule":
            return float(
                max(d @ np.asarray(e) for e in form.ends) + form.radius * np.linalg.norm(d)
            )
        case "cone":
            a, b = np.asarray(form.ends)
            axis = (b - a) / max(float(np.linalg.norm(b - a)), 1e-300)
            wide = np.linalg.norm(d - (d @ axis) * axis)
            return float(max(d @ a + form.radii[0] * wide, d @ b + form.radii[1] * wide))
        case "torus":
            flat = np.linalg.norm(d - (d @ form.axis) * np.asarray(form.axis))
            return float(d @ form.center + form.radius * flat + form.tube * np.linalg.norm(d))
        case "union":
            return max(reach(part, d) for part in form)
    return reach(form[0], d)


def bulge(shape: Shape) -> float:
    """How far [m] the shape may stick out beyond its reach, by blending."""
    if shape.form not in ("union", "difference"):
        return 0.0
    parts = getattr(shape, shape.form)
    if shape.form == "difference":
        return bulge(parts[0])
    return max(bulge(part) for part in parts) + (len(parts) - 1) * (shape.blend or 0.0) / 4


def steady(shape: Shape) -> bool:
    """Whether `distance` changes by no more than the way between two points. Near an ellipsoid it
    does not hold."""
    parts = getattr(shape, shape.form) if shape.form in ("union", "difference") else ()
    return shape.form != "ellipsoid" and all(steady(part) for part in parts)


def colors(shape: Shape, points: np.ndarray, default: tuple) -> np.ndarray:
    """Colour (n, 3) of `points`: of the first part of a union that holds them, else `default`."""
    own = shape.colour or default
    if shape.form == "difference":
        return colors(shape.difference[0], points, own)
    out = np.tile(np.asarray(own, dtype=float), (len(points), 1))
    if shape.form == "union":
        holder, nearest = np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
        for k, part in enumerate(shape.union):
            # points of no part (scenery's skin, rounding) take the nearest
            depth = distance(part, points)
            nearer = (nearest > 0) & (depth < nearest)
            holder[nearer], nearest[nearer] = k, depth[nearer]
        for k, part in enumerate(shape.union):
            mine = holder == k
            out[mine] = colors(part, points[mine], own)
    return out


def normals(shape: Shape, points: np.ndarray, step: float) -> np.ndarray:
    """Outward unit normals (n, 3) by central differences of the distance over 2 `step` [m]."""
    out = np.empty_like(points)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        out[:, axis] = distance(shape, points + shift) - distance(shape, points - shift)
    size = _length(out)[:, None]
    return np.where(size > 0, out / np.maximum(size, 1e-300), (0.0, 0.0, 1.0))


def lattice(
    inside: Judge, low: np.ndarray, high: np.ndarray, spacing: float, none: Judge | None = None
) -> np.ndarray:
    """Points (n, 3) of the lattice of cell centres (i + 1/2) spacing for which `inside` is true.

    inside: called with points (m, 3), few at a time so that memory stays bounded, returns (m,)
    bool. low, high: corners (3,) [m] of the region searched. none: for the middles (b, 3) of cubes
    of BLOCK points, whether `inside` is true of none in each (b,); these are not searched.
    """
    return np.concatenate([np.empty((0, 3)), *searched(inside, low, high, spacing, none)])


def searched(
    inside: Judge, low: np.ndarray, high: np.ndarray, spacing: float, none: Judge | None = None
) -> Iterator[np.ndarray]:
    """The points of `lattice`, part after part in their order."""
    start, stop = _ends(low, high, spacing)
    if none is None:
        for index in _boxes(start, stop, np.array([1, 1, 1]), _MOST):
            points = (index + 0.5) * spacing
            yield points[inside(points + TIE * spacing)]
        return
    cube = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    size = stop - start
    for first in range(start[0], stop[0], BLOCK):  # a layer of cubes, whose points are then sorted
        layer = [np.empty((0, 3), dtype=np.int64)]
        corner = np.array([first, start[1], start[2]])
        for cubes in _boxes(corner, np.array([first + 1, *stop[1:]]), np.array([BLOCK] * 3), _MOST):
            middles = (cubes + BLOCK / 2 + TIE) * spacing
            cubes = cubes[~none(middles)]
            for at in range(0, len(cubes), _MOST // BLOCK**3):
                some = cubes[at : at + _MOST // BLOCK**3]
                index = (some[:, None] + cube).reshape(-1, 3)
                index = index[(index < stop).all(axis=1)]
                layer.append(index[inside((index + 0.5) * spacing + TIE * spacing)])
        index = np.concatenate(layer)
        place = (index - start) @ np.array([size[1] * size[2], size[2], 1])
        yield (index[np.argsort(place)] + 0.5) * spacing


def worth_cubes(low: np.ndarray, high: np.ndarray, spacing: float) -> bool:
    """Whether the region is so wide that looking at cubes of points first saves time."""
    return BLOCK * span(low[1:], high[1:], spacing) >= _MOST


def span(low: np.ndarray, high: np.ndarray, spacing: float) -> float:
    """How many points of a lattice lie in the region that `lattice` searches; about."""
    return float(np.prod(np.ceil((np.asarray(high) - low) / spacing) + 2.0))


def _ends(low, high, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (3,) of the first point of a lattice in a region, and of the one after the last."""
    start = np.floor(np.asarray(low) / spacing).astype(np.int64) - 1
    return start, np.ceil(np.asarray(high) / spacing).astype(np.int64) + 1


def _boxes(start, stop, step, most: int) -> Iterator[np.ndarray]:
    """Indices (m, 3) from start to stop in steps (all (3,)), in order, about `most` at a time."""
    x, y, z = (range(*map(int, ends)) for ends in zip(start, stop, step, strict=True))
    high = min(len(z), most)
    wide = min(len(y), max(1, most // max(1, high))) if high == len(z) else 1
    deep = max(1, most // max(1, high * wide)) if wide == len(y) else 1
    for i in range(0, len(x), deep):
        for j in range(0, len(y), max(1, wide)):
            for k in range(0, len(z), max(1, high)):
                axes = (x[i : i + deep], y[j : j + wide], z[k : k + high])
                yield np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _length(v: np.ndarray) -> np.ndarray:
    return np.sqrt(v[:, 0] ** 2 + v[:, 1] ** 2 + v[:, 2] ** 2)


def _from_box(q: np.ndarray) -> np.ndarray:
    """Distance from |x - middle| - half edges, both (n, k)."""
    outside = np.maximum(q, 0.0)
    return np.sqrt((outside**2).sum(axis=1)) + np.minimum(q.max(axis=1), 0.0)


def _from_ellipsoid(x: np.ndarray, radii: np.ndarray) -> np.ndarray:
    k0, k1 = _length(x / radii), _length(x / radii**2)
    near = k0 * (k0 - 1.0) / np.maximum(k1, 1e-300)
    return np.where(k1 > 0, near, -radii.min())


def _union(parts: Iterator[np.ndarray], blend: float | None) -> np.ndarray:
    """Distance (n,) to the parts together, of the distances to each.

    Blended (Quilez 2013): each pair within `blend` of each other loses up to a quarter of it, so
    that edges between them become parabolas; slopes stay at most 1.
    """
    out = next(parts)
    for part in parts:
        lower = np.minimum(out, part)
        if blend is not None:
            lower = lower - np.maximum(blend - np.abs(out - part), 0.0) ** 2 / (4 * blend)
        out = lower
    return out


def _about_axis(ring: Torus, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance along the axis from the middle, and from the axis."""
    x, axis = points - np.asarray(ring.center), np.asarray(ring.axis)
    along = x[:, 0] * axis[0] + x[:, 1] * axis[1] + x[:, 2] * axis[2]
    return along, _length(x - along[:, None] * axis)


def _from_cone(cone: Cone, points: np.ndarray) -> np.ndarray:
    """From the two flat ends and the slope between their rims, in the half-plane of the axis."""
    along, across, length = _rod_coordinates(cone, points)
    first, second = cone.radii
    # the ends: discs at 0 and at `length`
    near_first = along <= length / 2
    beyond = np.maximum(across - np.where(near_first, first, second), 0.0)
    to_end = np.where(near_first, along, along - length) ** 2 + beyond**2
    # the slope: from (0, first) to (length, second)
    steep = (length, second - first)
    share = along * steep[0] + (across - first) * steep[1]
    share = np.clip(share / max(steep[0] ** 2 + steep[1] ** 2, 1e-300), 0.0, 1.0)
    to_slope = (along - share * steep[0]) ** 2 + (across - first - share * steep[1]) ** 2
    inside = (along > 0) & (along < length)
    inside &= across * length < first * length + along * steep[1]
    return np.where(inside, -1.0, 1.0) * np.sqrt(np.minimum(to_end, to_slope))


def _rod_coordinates(rod: Rod | Cone, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Distance along the axis from its first end, distance from the axis, length of the axis."""
    a, b = np.asarray(rod.ends)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / max(length, 1e-300)
    x = points - a
    along = x[:, 0] * axis[0] + x[:, 1] * axis[1] + x[:, 2] * axis[2]
    return along, _length(x - along[:, None] * axis), length


def _from_cylinder(rod: Rod, points: np.ndarray) -> np.ndarray:
    along, across, length = _rod_coordinates(rod, points)
    q = np.stack([np.abs(along - length / 2) - length / 2, across - rod.radius], axis=1)
    return _from_box(q)
