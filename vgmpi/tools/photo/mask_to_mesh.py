"""Closed surfaces from object masks.

A body is made about the eye at a distance of about 1, so that the camera sees it as its mask. Its
true distance scales it as a whole, which leaves its picture unchanged. Bodies are upright for every
pitch of the camera.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from vgmpi.preprocess.meshes.triangle_mesh import Mesh

from .grabcut import box_of
from .photo_camera import View

Reconstruction = Literal["inflate", "revolve", "extrude", "cup"]
OUTLINE_POINTS = 200  # lattice points along the longer side of an outline
CIRCLE_VERTICES = 64  # vertices of a circle
REVOLUTION_LEVELS = 300  # circles of a body of revolution
WIDTH_ITERATIONS = 4  # iterations for the width of an extruded body
DEPTH_SAMPLES = 24  # samples of an extruded body along its depth
PINHOLE = 16  # [lattice points] smaller holes of an outline are closed
THIN_PARTS = (0.3, 0.6)  # [-] relative radii below and above which parts are thin and thick
RADIUS_SMOOTHING = 2.0  # [lattice points] smoothing of the radius where a thin part begins
THICKNESS = 0.6  # [-] default depth of an extruded body relative to its width
_CONE_SLOPE = 0.6  # [-] circles form a cone from this slope on, relative to the line of sight
OUTLINE_SMOOTHING = 1.0  # [pixels] smoothing of the jagged outline, as the smallest circle counts
MAX_PULL = 0.8  # [lattice steps] by which a corner of a rim is moved to the outline
INSET = 0.6  # [pixels] outlines lie this far inside their masks
_MIN_END_RADIUS = 0.1  # [-] ends thinner than this fraction of the largest radius are cut off


class BodyError(ValueError):
    """Error of a mask from which no body can be made; one line."""


class Profile(NamedTuple):
    """Body of revolution about an upright axis at the depth 1."""

    axis: float  # position of the axis across
    heights: np.ndarray  # (n,) ascending
    radius: np.ndarray  # (n,)


class Lattice(NamedTuple):
    """Evenly spaced sample points of an outline and their inside flags.

    Fields are the coordinates `across` (columns,) and `up` (rows,) of the point centers, `inside`
    (rows, columns) bool, and the spacing `step`.
    """

    across: np.ndarray
    up: np.ndarray
    inside: np.ndarray
    step: float


def body(
    mask: np.ndarray, view: View, method: Reconstruction, thickness: float = THICKNESS
) -> Mesh:
    """Return the surface of a body in upright axes about the eye, about 1 away.

    Args:
        mask: The object, shape (height, width) bool, not empty.
        view: Camera of the photograph.
        method: Inflate the outline, revolve it about an upright axis, or extrude it.
        thickness: Depth of an extruded body relative to its width.

    Raises:
        BodyError: The mask gives no body by this method.
    """
    if method == "inflate":
        return _inflated(mask, view)
    if method == "extrude":
        return _extruded(eroded_mask(mask), view, thickness)
    return _revolved(eroded_mask(mask), view)


def inflated_surface(mask: np.ndarray, view: View) -> Mesh:
    """Return the surface of an inflated mask (height, width) bool about the eye, about 1 away.

    All of its sections are as thick as they are wide.

    Raises:
        BodyError: The mask gives no body.
    """
    return _inflated(mask, view, is_thin=True)


def poisson_height(inside: np.ndarray) -> np.ndarray:
    """Return half the thickness of an inflated outline in lattice steps.

    The half thickness is sqrt(4 u), where the Laplacian of u is -1 and u vanishes on the outline; a
    disc becomes a ball. Input and output have shape (rows, columns).
    """
    padded = np.pad(inside, 1)
    number = np.full(padded.shape, -1)
    number[padded] = np.arange(padded.sum())
    y, x = np.nonzero(padded)
    rows, columns = [], []
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        neighbors = number[y + dy, x + dx]
        rows.append(np.flatnonzero(neighbors >= 0))
        columns.append(neighbors[neighbors >= 0])
    entries = np.concatenate(rows), np.concatenate(columns)
    neighbors = sparse.csc_matrix((np.full(len(entries[0]), -1.0), entries), (len(y), len(y)))
    u = np.zeros(padded.shape)
    u[padded] = spsolve(neighbors + 4 * sparse.eye(len(y), format="csc"), np.ones(len(y)))
    return np.sqrt(4 * np.maximum(u, 0))[1:-1, 1:-1]


def local_radius(depth: np.ndarray) -> np.ndarray:
    """Return the radius of the largest disc inside an outline that covers each point.

    Input, the distances from the outline, and output have shape (rows, columns) and are in lattice
    steps.
    """
    inside, radius = depth > 0, depth.copy()
    for level in np.arange(1.0, depth.max() + 0.5, 0.5):
        is_covered = ndimage.distance_transform_edt(depth < level) < level
        radius = np.where(inside & is_covered, np.maximum(radius, level), radius)
    weight = ndimage.gaussian_filter(inside.astype(np.float64), RADIUS_SMOOTHING)
    smooth = ndimage.gaussian_filter(radius * inside, RADIUS_SMOOTHING) / np.maximum(weight, 1e-9)
    return np.where(inside, np.maximum(smooth, depth), 0.0)


def inflated_height(inside: np.ndarray, is_thin: bool = False) -> np.ndarray:
    """Return half the thickness of an inflated outline, whose thin parts have round sections.

    A soap film alone is 1.41 times as thick over a long strip as the strip is wide.

    Args:
        inside: Outline, shape (rows, columns) bool.
        is_thin: Whether all of it is a thin part, as of a handle; otherwise parts are thin where
            the largest disc inside them is less than THIN_PARTS of the largest one of all.

    Returns:
        Lattice steps, shape (rows, columns).
    """
    depth = ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
    film, radius = poisson_height(inside), local_radius(depth)
    depth = np.maximum(depth - 0.5, 0)  # from the outline to the middle of a lattice cell
    width = np.maximum(radius - 0.25, depth)  # the middle lies between two cells, or not
    section = np.minimum(film, np.sqrt(depth * (2 * width - depth)))
    share = radius / max(float(radius.max()), 1e-9)
    low, high = THIN_PARTS
    weight = 1.0 if is_thin else np.clip((high - share) / (high - low), 0.0, 1.0)
    return film + weight * (section - film)


def eroded_mask(mask: np.ndarray) -> np.ndarray:
    """Return mask coverage (height, width) whose half level lies INSET inside the outline.

    Gaussians on a rim are seen about that far beyond it.
    """
    return _coverage(mask, depth_in_mask(mask))


def _coverage(mask: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return `eroded_mask` of a mask whose depth is known, both (height, width)."""
    coverage = np.clip(depth - INSET + 0.5, 0, 1)
    return coverage if coverage.max() > 0.9 else mask.astype(np.float64)


def depth_in_mask(mask: np.ndarray) -> np.ndarray:
    """Return how far inside the outline pixels are [pixels], negative outside.

    Input, bool, and output have shape (height, width).
    """
    depth = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    return ndimage.gaussian_filter(depth - np.where(mask, 0.5, -0.5), OUTLINE_SMOOTHING)


def inside_mask(mask: np.ndarray, view: View, points: np.ndarray) -> np.ndarray:
    """Return whether points (..., 3) about the eye are seen inside the mask (...)."""
    return sample_mask(mask, view, points) > 0.5


def sample_mask(mask: np.ndarray, view: View, points: np.ndarray) -> np.ndarray:
    """Interpolate mask coverage at the pixels where points (..., 3) about the eye are seen."""
    pixels, _ = view.pixels(points)
    coverage = ndimage.map_coordinates(
        mask, np.nan_to_num(pixels[..., ::-1] - 0.5, nan=-9.0).reshape(-1, 2).T,
        order=1, cval=0.0,
    )  # fmt: skip
    return coverage.reshape(pixels.shape[:-1])


def _lattice(mask: np.ndarray, view: View) -> Lattice:
    """Sample the outline on the upright plane at distance 1 with a uniform spacing."""
    box = box_of(mask > 0.5)
    rim = np.argwhere(mask > 0.5)[:, ::-1] + 0.5
    rays = view.rays(rim)
    if not (rays[:, 1] > 0.05).all():
        message = f"lies far below or above a camera that looks down by {view.pitch:g} degrees"
        raise BodyError(f"it {message}: only reconstruction = 'inflate' can be made there")
    flat = rays[:, ::2] / rays[:, 1:2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = float((high - low).max()) * (1 + 2 / max(box.right - box.left, box.bottom - box.top))
    step = size / OUTLINE_POINTS
    middle = (low + high) / 2
    counts = np.ceil((high - low) / step).astype(int) + 6
    across = middle[0] + step * (np.arange(counts[0]) - (counts[0] - 1) / 2)
    up = middle[1] + step * (np.arange(counts[1]) - (counts[1] - 1) / 2)
    a, b = np.meshgrid(across, up)
    return Lattice(across, up, inside_mask(mask, view, np.stack([a, np.ones_like(a), b], -1)), step)


def _inflated(mask: np.ndarray, view: View, is_thin: bool = False) -> Mesh:
    """Inflate an outline into two height fields along the lines of sight.

    The fields lie over the plane that faces the middle of the outline, and share their rim.
    """
    outline = depth_in_mask(mask)
    mask = _coverage(mask, outline)
    rays = view.rays(np.argwhere(mask > 0.5)[:, ::-1] + 0.5)
    forward = rays.mean(axis=0)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0) if abs(forward[2]) < 0.9 else (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward)])
    flat = rays @ axes.T / (rays @ forward)[:, None]
    low, high = flat.min(axis=0), flat.max(axis=0)
    step = float((high - low).max()) / OUTLINE_POINTS
    counts = np.ceil((high - low) / step).astype(int) + 6
    first = (low + high) / 2 - step * counts / 2
    x, y = (first[k] + step * np.arange(counts[k] + 1) for k in (0, 1))
    corners = forward + np.stack(np.meshgrid(x, y), -1) @ axes
    middles = (corners[1:, 1:] + corners[:-1, :-1]) / 2
    inside = _largest_component(inside_mask(mask, view, middles))
    half = inflated_height(inside, is_thin) * step
    corner = ndimage.uniform_filter(np.pad(half, 1), 2)[1:, 1:]
    is_complete = ndimage.minimum_filter(np.pad(inside, 1).astype(np.uint8), 2)[1:, 1:] > 0
    corner = np.where(is_complete, corner, 0.0)
    is_rim = ndimage.maximum_filter(np.pad(inside, 1).astype(np.uint8), 2)[1:, 1:] > is_complete
    pull = _offset_to_outline(sample_mask(outline - INSET, view, corners), step) * is_rim[..., None]
    corners = corners + pull @ axes
    points = [(corners * (1 + side * corner[..., None])).reshape(-1, 3) for side in (-1, 1)]
    squares = _squares(inside)
    return Mesh(
        np.concatenate(points), np.concatenate([squares, squares[:, ::-1] + len(points[0])])
    )


def _offset_to_outline(depth: np.ndarray, step: float) -> np.ndarray:
    """Return the offsets of corners to the outline, across and up, at most MAX_PULL steps long.

    Without it the rim of a body is a staircase of lattice steps, which are several pixels long in
    large photographs.

    Args:
        depth: Distance of the corners inside the outline, shape (rows, columns) [pixels].
        step: Distance of the corners.
    """
    slope = np.stack(np.gradient(depth, step)[::-1], -1)
    offset = -depth[..., None] * slope / np.maximum((slope**2).sum(-1, keepdims=True), 1e-12)
    length = np.linalg.norm(offset, axis=-1, keepdims=True)
    return offset * np.minimum(1.0, MAX_PULL * step / np.maximum(length, 1e-12))


def _extruded(mask: np.ndarray, view: View, thickness: float) -> Mesh:
    """Extrude the largest outline whose level extrusion away from the camera stays in the mask."""
    lattice = _lattice(mask, view)
    a, b = np.meshgrid(lattice.across, lattice.up)
    inside = lattice.inside
    for _ in range(WIDTH_ITERATIONS):  # outline and depth depend on each other
        depth = thickness * (float(np.ptp(lattice.across[inside.any(axis=0)])) + lattice.step)
        inside = np.ones(a.shape, dtype=bool)
        for offset in np.linspace(0, depth, DEPTH_SAMPLES):
            inside &= inside_mask(mask, view, np.stack([a, np.full_like(a, 1 + offset), b], -1))
        if inside.sum() < 16:
            message = f"nothing of it is {thickness:g} of its width thick"
            raise BodyError(f"{message}: a smaller thickness, or another reconstruction")
    inside = _largest_component(inside)
    x = np.append(lattice.across - lattice.step / 2, lattice.across[-1] + lattice.step / 2)
    z = np.append(lattice.up - lattice.step / 2, lattice.up[-1] + lattice.step / 2)
    gx, gz = np.meshgrid(x, z)
    count = gx.size
    points = [np.stack([gx, np.full_like(gx, y), gz], -1).reshape(-1, 3) for y in (1, 1 + depth)]
    squares = _squares(inside)
    faces = [squares[:, ::-1], squares + count, _walls(inside, count)]
    return Mesh(np.concatenate(points), np.concatenate(faces))


def revolution_profile(mask: np.ndarray, view: View) -> Profile:
    """Return circles about an upright axis, each the largest that is seen inside the mask.

    Beyond the upper and the lower end such circles would form cones of lines of sight: these are
    cut off, and the body ends flat.

    Args:
        mask: Coverage of the mask, shape (height, width).
        view: Camera of the photograph.

    Raises:
        BodyError: No upright body of revolution is seen so.
    """
    lattice = _lattice(mask, view)
    rows = np.flatnonzero(lattice.inside.any(axis=1))
    ends = np.array([lattice.across[np.flatnonzero(lattice.inside[r])[[0, -1]]] for r in rows])
    axis = np.tan(np.median(np.arctan(ends).mean(axis=1)))
    max_radius = 0.55 * float(np.ptp(ends, axis=1).max()) + lattice.step
    low, high = lattice.up[rows[0]], lattice.up[rows[-1]]
    low, high = min(low, low * (1 - max_radius)), max(high, high * (1 + max_radius))
    heights = np.linspace(low, high, REVOLUTION_LEVELS)
    turn = 2 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
    radii = np.linspace(0, max_radius, OUTLINE_POINTS // 2)
    h, t, r = np.meshgrid(heights, turn, radii, indexing="ij")
    coverage = sample_mask(mask, view, np.stack([axis + r * np.cos(t), 1 + r * np.sin(t), h], -1))
    reach = _first_below(coverage) * radii[1]  # (heights, turn)
    radius = ndimage.median_filter(reach.min(axis=1), 5, mode="nearest")
    first, last = _ends(heights, radius, (lattice.up[rows[0]], lattice.up[rows[-1]]))
    if last - first < 4:
        raise BodyError(
            "no upright body of revolution is seen as its mask: reconstruction = 'inflate'?"
        )
    return Profile(float(axis), heights[first : last + 1], radius[first : last + 1])


def _revolved(mask: np.ndarray, view: View) -> Mesh:
    """Return the surface of a body of revolution with flat ends."""
    axis, heights, radius = revolution_profile(mask, view)
    turn = 2 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(CIRCLE_VERTICES)], -1)
    middle = np.stack([np.full(len(heights), axis), np.ones(len(heights)), heights], -1)
    points = (middle[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(len(heights) - 1), np.arange(CIRCLE_VERTICES), indexing="ij")
    following = (j + 1) % CIRCLE_VERTICES
    square = [
        k * CIRCLE_VERTICES + j,
        k * CIRCLE_VERTICES + following,
        (k + 1) * CIRCLE_VERTICES + following,
        (k + 1) * CIRCLE_VERTICES + j,
    ]
    a, b, c, d = (corner.ravel() for corner in square)
    sides = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    bottom, top, now = len(points), len(points) + 1, np.arange(CIRCLE_VERTICES)
    after, upper = (now + 1) % CIRCLE_VERTICES, (len(heights) - 1) * CIRCLE_VERTICES
    lids = np.concatenate([
        np.stack([np.full(CIRCLE_VERTICES, bottom), after, now], 1),
        np.stack([np.full(CIRCLE_VERTICES, top), upper + now, upper + after], 1),
    ])  # fmt: skip
    return Mesh(np.concatenate([points, middle[[0, -1]]]), np.concatenate([sides, lids]))


def _first_below(coverage: np.ndarray) -> np.ndarray:
    """Return positions (...) where coverage (..., n) first falls below 0.5 on its last axis."""
    count = np.logical_and.accumulate(coverage > 0.5, axis=-1).sum(axis=-1)
    last = np.clip(count, 1, coverage.shape[-1] - 1)[..., None]
    before = np.take_along_axis(coverage, last - 1, -1)[..., 0]
    after = np.take_along_axis(coverage, last, -1)[..., 0]
    fraction = (before - 0.5) / np.maximum(before - after, 1e-6)
    return np.where(count > 0, last[..., 0] - 1 + np.clip(fraction, 0, 1), 0.0)


def _ends(heights: np.ndarray, radius: np.ndarray, rows: tuple[float, float]) -> tuple[int, int]:
    """Return the first and the last circle of a body without the cones beyond its ends.

    rows: slopes of the lines of sight along these cones, equal to the slopes of the cones.
    """
    occupied = np.flatnonzero(radius > 0)
    if len(occupied) < 5:
        return 0, 0
    first, last = int(occupied[0]), int(occupied[-1])
    slope = np.gradient(ndimage.uniform_filter1d(radius, 5, mode="nearest"), heights)
    cone_slopes = [_CONE_SLOPE / max(abs(row), 1e-6) for row in rows]
    thin = radius < _MIN_END_RADIUS * radius.max()
    while first < last and (slope[first] >= cone_slopes[0] or thin[first]):
        first += 1
    while last > first and (slope[last] <= -cone_slopes[1] or thin[last]):
        last -= 1
    return first, last


def _largest_component(inside: np.ndarray) -> np.ndarray:
    """Return the largest component without one-pixel threads and without pinholes."""
    opened = ndimage.binary_opening(inside)
    cleaned = opened if opened.sum() > 0.5 * inside.sum() else inside
    label, count = ndimage.label(cleaned)
    if not count:
        raise BodyError("its mask is too thin for a body")
    size = ndimage.sum_labels(cleaned, label, np.arange(1, count + 1))
    part = label == 1 + int(np.argmax(size))
    holes, count = ndimage.label(ndimage.binary_fill_holes(part) & ~part)
    if not count:
        return part
    area = ndimage.sum_labels(holes > 0, holes, np.arange(1, count + 1))
    return part | np.isin(holes, 1 + np.flatnonzero(area < PINHOLE))


def _squares(inside: np.ndarray) -> np.ndarray:
    """Return two triangles for each inside point, by the indices of its vertices.

    Vertices are numbered row by row, (rows + 1) by (columns + 1).
    """
    stride = inside.shape[1] + 1
    r, c = np.nonzero(inside)
    a, b = r * stride + c, r * stride + c + 1
    d, e = a + stride, b + stride
    return np.concatenate([np.stack([a, b, e], 1), np.stack([a, e, d], 1)])


def _walls(inside: np.ndarray, count: int) -> np.ndarray:
    """Return two triangles for each edge between inside and outside.

    They join the vertices of the front with the vertices of the back, whose indices are `count`
    higher.
    """
    stride = inside.shape[1] + 1
    padded = np.pad(inside, 1)
    triangles = []
    for dr, dc, first, second in (
        (-1, 0, 0, 1), (0, 1, 1, stride + 1), (1, 0, stride + 1, stride), (0, -1, stride, 0),
    ):  # fmt: skip
        neighbor = padded[1 + dr : padded.shape[0] - 1 + dr, 1 + dc : padded.shape[1] - 1 + dc]
        r, c = np.nonzero(inside & ~neighbor)
        a, b = r * stride + c + first, r * stride + c + second
        triangles += [np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)]
    return np.concatenate(triangles)
