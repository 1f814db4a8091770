"""A mask becomes a closed surface, seen by the camera as the mask is.

Surfaces are made about the eye at a distance of about 1; their true distance scales them as a
whole, which changes nothing in the picture. They stand upright whatever the camera's pitch.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from vgmpi.images.masks import box_of
from vgmpi.images.view import View
from vgmpi.prepare.mesh import Mesh

Form = Literal["inflate", "revolve", "extrude"]
ACROSS = 200  # places along the longer side of an outline
ROUND = 64  # corners of a circle
LEVELS = 300  # circles of what is revolved
AGAIN = 4  # rounds in which the width of what is extruded is found
DEEP = 24  # places along the way into the picture of what is extruded
THICKNESS = 0.6  # of what is extruded, relative to its width, where nothing is told
_STEEP = 0.6  # slope relative to that of a line of sight from which circles make its cone
SMOOTH = 1.0  # pixels: an outline of pixels is jagged, and the smallest circle counts
INSET = 0.6  # pixels
_SMALL = 0.1  # of the largest radius: a body has no thinner ends


class BodyError(ValueError):
    """A mask of which no body can be made; one line."""


class Lattice(NamedTuple):
    """Places (columns, rows), evenly apart by `step`, and which of them are inside (rows, columns).

    across, up: coordinates of the middles of columns and rows.
    """

    across: np.ndarray
    up: np.ndarray
    inside: np.ndarray
    step: float


def body(mask: np.ndarray, view: View, form: Form, thickness: float = THICKNESS) -> Mesh:
    """The surface of a body, its points (n, 3) in upright axes about the eye, about 1 away.

    mask: (height, width) bool, not empty. thickness: of what is extruded, how far it goes into the
    picture relative to its width. Raises BodyError.
    """
    mask = inner(mask)
    if form == "inflate":
        return _inflated(mask, view)
    if form == "extrude":
        return _extruded(mask, view, thickness)
    return _revolved(mask, view)


def poisson_height(inside: np.ndarray) -> np.ndarray:
    """Half the thickness of an inflated outline (rows, columns), in places: sqrt(4 u) where the
    Laplacian of u is -1 and u is 0 on the outline, which makes a ball of a disc."""
    wide = np.pad(inside, 1)
    number = np.full(wide.shape, -1)
    number[wide] = np.arange(wide.sum())
    y, x = np.nonzero(wide)
    rows, columns = [], []
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        beside = number[y + dy, x + dx]
        rows.append(np.flatnonzero(beside >= 0))
        columns.append(beside[beside >= 0])
    at = np.concatenate(rows), np.concatenate(columns)
    beside = sparse.csc_matrix((np.full(len(at[0]), -1.0), at), (len(y), len(y)))
    u = np.zeros(wide.shape)
    u[wide] = spsolve(beside + 4 * sparse.eye(len(y), format="csc"), np.ones(len(y)))
    return np.sqrt(4 * np.maximum(u, 0))[1:-1, 1:-1]


def inner(mask: np.ndarray) -> np.ndarray:
    """Shares of pixels (height, width), a half where an outline lies INSET inside the mask's:
    Gaussians on a rim are seen that far beyond it."""
    deep = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    deep = ndimage.gaussian_filter(deep - np.where(mask, 0.5, -0.5), SMOOTH)
    soft = np.clip(deep - INSET + 0.5, 0, 1)
    return soft if soft.max() > 0.9 else mask.astype(np.float64)


def within(mask: np.ndarray, view: View, points: np.ndarray) -> np.ndarray:
    """Whether points (..., 3) about the eye are seen inside the mask (...)."""
    return share(mask, view, points) > 0.5


def share(mask: np.ndarray, view: View, points: np.ndarray) -> np.ndarray:
    """A mask of shares where points (..., 3) about the eye are seen (...), between its pixels."""
    at, _ = view.pixels(points)
    soft = ndimage.map_coordinates(
        mask, np.nan_to_num(at[..., ::-1] - 0.5, nan=-9.0).reshape(-1, 2).T,
        order=1, cval=0.0,
    )  # fmt: skip
    return soft.reshape(at.shape[:-1])


def _lattice(mask: np.ndarray, view: View) -> Lattice:
    """The outline on the upright plane a distance of 1 away, in places of one size."""
    box = box_of(mask > 0.5)
    rim = np.argwhere(mask > 0.5)[:, ::-1] + 0.5
    rays = view.rays(rim)
    if not (rays[:, 1] > 0.05).all():
        said = f"lies far below or above a camera that looks down by {view.pitch:g} degrees"
        raise BodyError(f"it {said}: only form = 'inflate' can be made there")
    flat = rays[:, ::2] / rays[:, 1:2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = float((high - low).max()) * (1 + 2 / max(box.right - box.left, box.bottom - box.top))
    step = size / ACROSS
    middle = (low + high) / 2
    counts = np.ceil((high - low) / step).astype(int) + 6
    across = middle[0] + step * (np.arange(counts[0]) - (counts[0] - 1) / 2)
    up = middle[1] + step * (np.arange(counts[1]) - (counts[1] - 1) / 2)
    a, b = np.meshgrid(across, up)
    return Lattice(across, up, within(mask, view, np.stack([a, np.ones_like(a), b], -1)), step)


def _inflated(mask: np.ndarray, view: View) -> Mesh:
    """Two fields of heights along the lines of sight, over the plane that the middle of the outline
    is seen at a right angle on; they share their rim."""
    rays = view.rays(np.argwhere(mask > 0.5)[:, ::-1] + 0.5)
    ahead = rays.mean(axis=0)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0) if abs(ahead[2]) < 0.9 else (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead)])
    flat = rays @ axes.T / (rays @ ahead)[:, None]
    low, high = flat.min(axis=0), flat.max(axis=0)
    step = float((high - low).max()) / ACROSS
    counts = np.ceil((high - low) / step).astype(int) + 6
    first = (low + high) / 2 - step * counts / 2
    x, y = (first[k] + step * np.arange(counts[k] + 1) for k in (0, 1))
    corners = ahead + np.stack(np.meshgrid(x, y), -1) @ axes
    middles = (corners[1:, 1:] + corners[:-1, :-1]) / 2
    inside = _one_piece(within(mask, view, middles))
    half = poisson_height(inside) * step
    corner = ndimage.uniform_filter(np.pad(half, 1), 2)[1:, 1:]
    whole = ndimage.minimum_filter(np.pad(inside, 1).astype(np.uint8), 2)[1:, 1:] > 0
    corner = np.where(whole, corner, 0.0)
    points = [(corners * (1 + side * corner[..., None])).reshape(-1, 3) for side in (-1, 1)]
    squares = _squares(inside)
    return Mesh(
        np.concatenate(points), np.concatenate([squares, squares[:, ::-1] + len(points[0])])
    )


def _extruded(mask: np.ndarray, view: View, thickness: float) -> Mesh:
    """The largest outline whose extrusion, level and away from the camera, is seen in the mask."""
    at = _lattice(mask, view)
    a, b = np.meshgrid(at.across, at.up)
    inside = at.inside
    for _ in range(AGAIN):  # its width is told by the outline, which its depth tells
        deep = thickness * (float(np.ptp(at.across[inside.any(axis=0)])) + at.step)
        inside = np.ones(a.shape, dtype=bool)
        for away in np.linspace(0, deep, DEEP):
            inside &= within(mask, view, np.stack([a, np.full_like(a, 1 + away), b], -1))
        if inside.sum() < 16:
            said = f"nothing of it is {thickness:g} of its width thick"
            raise BodyError(f"{said}: a smaller thickness, or another form")
    inside = _one_piece(inside)
    x = np.append(at.across - at.step / 2, at.across[-1] + at.step / 2)
    z = np.append(at.up - at.step / 2, at.up[-1] + at.step / 2)
    gx, gz = np.meshgrid(x, z)
    count = gx.size
    points = [np.stack([gx, np.full_like(gx, y), gz], -1).reshape(-1, 3) for y in (1, 1 + deep)]
    squares = _squares(inside)
    faces = [squares[:, ::-1], squares + count, _walls(inside, count)]
    return Mesh(np.concatenate(points), np.concatenate(faces))


def _revolved(mask: np.ndarray, view: View) -> Mesh:
    """Circles about an upright axis, each the largest that is seen inside the mask.

    Above its upper end and below its lower one such circles make cones of lines of sight:
    these are left out, and the body ends flat.
    """
    at = _lattice(mask, view)
    rows = np.flatnonzero(at.inside.any(axis=1))
    ends = np.array([at.across[np.flatnonzero(at.inside[r])[[0, -1]]] for r in rows])
    axis = np.tan(np.median(np.arctan(ends).mean(axis=1)))
    most = 0.55 * float(np.ptp(ends, axis=1).max()) + at.step
    low, high = at.up[rows[0]], at.up[rows[-1]]
    low, high = min(low, low * (1 - most)), max(high, high * (1 + most))
    heights = np.linspace(low, high, LEVELS)
    turn = 2 * np.pi * np.arange(ROUND) / ROUND
    radii = np.linspace(0, most, ACROSS // 2)
    h, t, r = np.meshgrid(heights, turn, radii, indexing="ij")
    seen = share(mask, view, np.stack([axis + r * np.cos(t), 1 + r * np.sin(t), h], -1))
    reach = _first_below(seen) * radii[1]  # (heights, turn)
    radius = ndimage.median_filter(reach.min(axis=1), 5, mode="nearest")
    first, last = _ends(heights, radius, (at.up[rows[0]], at.up[rows[-1]]))
    if last - first < 4:
        raise BodyError("no upright body of revolution is seen as its mask: form = 'inflate'?")
    heights, radius = heights[first : last + 1], radius[first : last + 1]
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(ROUND)], -1)
    middle = np.stack([np.full(len(heights), axis), np.ones(len(heights)), heights], -1)
    points = (middle[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(len(heights) - 1), np.arange(ROUND), indexing="ij")
    on = (j + 1) % ROUND
    square = [k * ROUND + j, k * ROUND + on, (k + 1) * ROUND + on, (k + 1) * ROUND + j]
    a, b, c, d = (corner.ravel() for corner in square)
    sides = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    bottom, top, now = len(points), len(points) + 1, np.arange(ROUND)
    after, upper = (now + 1) % ROUND, (len(heights) - 1) * ROUND
    lids = np.concatenate([
        np.stack([np.full(ROUND, bottom), after, now], 1),
        np.stack([np.full(ROUND, top), upper + now, upper + after], 1),
    ])  # fmt: skip
    return Mesh(np.concatenate([points, middle[[0, -1]]]), np.concatenate([sides, lids]))


def _first_below(seen: np.ndarray) -> np.ndarray:
    """Where shares (..., n) first fall below a half along the last axis, in places (...)."""
    count = np.logical_and.accumulate(seen > 0.5, axis=-1).sum(axis=-1)
    last = np.clip(count, 1, seen.shape[-1] - 1)[..., None]
    before = np.take_along_axis(seen, last - 1, -1)[..., 0]
    after = np.take_along_axis(seen, last, -1)[..., 0]
    part = (before - 0.5) / np.maximum(before - after, 1e-6)
    return np.where(count > 0, last[..., 0] - 1 + np.clip(part, 0, 1), 0.0)


def _ends(heights: np.ndarray, radius: np.ndarray, rows: tuple[float, float]) -> tuple[int, int]:
    """The first and the last of the circles that are the body's, without the cones beyond its ends;
    rows: slopes of the lines of sight along these cones, which are their slopes too."""
    told = np.flatnonzero(radius > 0)
    if len(told) < 5:
        return 0, 0
    first, last = int(told[0]), int(told[-1])
    slope = np.gradient(ndimage.uniform_filter1d(radius, 5, mode="nearest"), heights)
    steep = [_STEEP / max(abs(row), 1e-6) for row in rows]
    thin = radius < _SMALL * radius.max()
    while first < last and (slope[first] >= steep[0] or thin[first]):
        first += 1
    while last > first and (slope[last] <= -steep[1] or thin[last]):
        last -= 1
    return first, last


def _one_piece(inside: np.ndarray) -> np.ndarray:
    """The largest piece, without threads of one place and without holes."""
    opened = ndimage.binary_opening(inside)
    kept = opened if opened.sum() > 0.5 * inside.sum() else inside
    label, count = ndimage.label(kept)
    if not count:
        raise BodyError("its mask is too thin for a body")
    size = ndimage.sum_labels(kept, label, np.arange(1, count + 1))
    return ndimage.binary_fill_holes(label == 1 + int(np.argmax(size)))


def _squares(inside: np.ndarray) -> np.ndarray:
    """Two triangles for each place inside, of the numbers of its corners: rows + 1 by columns + 1,
    row by row."""
    wide = inside.shape[1] + 1
    r, c = np.nonzero(inside)
    a, b = r * wide + c, r * wide + c + 1
    d, e = a + wide, b + wide
    return np.concatenate([np.stack([a, b, e], 1), np.stack([a, e, d], 1)])


def _walls(inside: np.ndarray, count: int) -> np.ndarray:
    """Two triangles for each edge between inside and outside, from the front's corners to those of
    the back, `count` later."""
    wide = inside.shape[1] + 1
    held = np.pad(inside, 1)
    found = []
    for dr, dc, first, second in (
        (-1, 0, 0, 1), (0, 1, 1, wide + 1), (1, 0, wide + 1, wide), (0, -1, wide, 0),
    ):  # fmt: skip
        other = held[1 + dr : held.shape[0] - 1 + dr, 1 + dc : held.shape[1] - 1 + dc]
        r, c = np.nonzero(inside & ~other)
        a, b = r * wide + c + first, r * wide + c + second
        found += [np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)]
    return np.concatenate(found)
