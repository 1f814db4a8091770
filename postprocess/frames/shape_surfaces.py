"""Surfaces of bodies made of shapes, as flat Gaussians that their particles carry.

The Gaussians of such a body are round and lie on a lattice inside. Points of a finer lattice on
both sides of the surface are moved onto it by the signed distance of the shape: those inside reach
both faces of a hollow edge, those outside both faces of a sharp one. What comes to lie on an edge
itself is left out. Round Gaussians right below the surface are not drawn.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians import shape_distance, shape_evolution
from vgmpi.gaussians.cloud import pack_symmetric

from ..studio import body_normals, surface_edges
from .appearance import Appearance
from .frame_gaussians import GaussianBatch

FORMS = (
    "box", "sphere", "ellipsoid", "cylinder", "capsule", "cone", "torus",
    "union", "difference", "intersection",
)  # fmt: skip
COMPOUND = ("union", "difference", "intersection")
GAP = 0.5  # [spacings] distance of the points
WIDTH = 0.35  # [spacings] standard deviation of a flat Gaussian
FLATNESS = 0.1  # [-] its thickness relative to that
COVERED = 1.3  # [spacings] depth down to which round Gaussians are not drawn
STEP = 0.05  # [spacings] step of the differences that give normals
RADIUS = (3 / (4 * np.pi)) ** (1 / 3)  # [spacings] standard deviation of the round Gaussians
MIN_OPACITY = 0.5  # [-] bodies that are fainter show their inside
STEPS = 2  # towards the surface
ON_SURFACE = 0.05  # [spacings] largest distance of a point that has arrived
PART = 1 << 13  # [points] whose distances are computed at once, so that they stay in the caches
SMOOTH = 0.9  # [-] least slope of the distance at a point; it is less at an edge


class ShapeSurface(NamedTuple):
    """Flat Gaussians of some bodies at rest.

    Attributes:
        parent: Rows of the particles that carry them, shape (n,).
        shift: Vectors from these to them, shape (n, 3) [m].
        normal: Outward unit normals, shape (n, 3).
        cov: Covariances, shape (n, 6) [m2].
        covered: Rows of the particles below them.
    """

    parent: np.ndarray
    shift: np.ndarray
    normal: np.ndarray
    cov: np.ndarray
    covered: np.ndarray


def surface_of_bodies(look: Appearance) -> ShapeSurface | None:
    """Return the flat Gaussians of the solid bodies made of shapes, None if there are none.

    Bodies that are faint, or whose Gaussians were merged, or that lack a deformation, have none.
    """
    surfaces: list[ShapeSurface] = []
    merged = () if look.passive is None else np.unique(look.run.gaussians.passive.object)
    x0 = np.asarray(look.run.gaussians.x0, dtype=np.float64)
    for k, placed in enumerate(_shapes_of(look)):
        entry = look.objects[k]
        has_surface = entry.get("family") == "solid" and entry.get("tracks_deformation", True)
        if placed is None or not has_surface or k in merged:
            continue
        members = np.flatnonzero(look.object == k)
        if len(members) and np.median(look.opacity[members]) >= MIN_OPACITY:
            spacing = float(np.cbrt(np.median(look.vol0[members])))
            surfaces.append(_in_rows(_surface_of(*placed, x0[members], spacing), members))
    return _joined(surfaces)


def surface_of_scenery(look: Appearance) -> ShapeSurface | None:
    """Return the flat Gaussians of scenery made of shapes, None if there is none."""
    if look.scenery is None:
        return None
    surfaces: list[ShapeSurface] = []
    object_ids = np.asarray(look.run.gaussians.scenery.object)
    for k, placed in enumerate(_shapes_of(look)):
        members = np.flatnonzero(object_ids == k)
        if placed is None or not len(members):
            continue
        if np.median(look.scenery.opacity[members]) >= MIN_OPACITY:
            sd = np.sqrt(np.median(look.scenery.cov0[members, 0]))
            spacing = float(sd / RADIUS)
            surfaces.append(
                _in_rows(_surface_of(*placed, look.scenery.x0[members], spacing), members)
            )
    return _joined(surfaces)


def carry(
    surface: ShapeSurface, part: GaussianBatch, rows: np.ndarray, F: np.ndarray
) -> tuple[GaussianBatch, np.ndarray, np.ndarray]:
    """Return the flat Gaussians of a frame, their normals (m, 3), and which of all they are (m,).

    Args:
        surface: All of them at rest.
        part: Gaussians that carry them.
        rows: Row of the carrier of each in `part`, shape (n,), -1 for absent ones.
        F: Deformations of the carriers, shape (n, 9), with any values for absent ones.
    """
    present = np.flatnonzero(rows >= 0)
    rows, F = rows[present], np.ascontiguousarray(F[present], dtype=np.float64)
    x = part.x[rows] + np.einsum("nij,nj->ni", F.reshape(-1, 3, 3), surface.shift[present])
    normal = np.empty((len(present), 3))
    body_normals.turn_normals(surface.normal[present], F, normal)
    cov = shape_evolution.deformed_covariance(surface.cov[present], F)
    bright = None if part.bright is None else part.bright[rows]
    batch = GaussianBatch(
        x, cov, part.opacity[rows], part.color, part.rows[rows], bright=bright
    )  # fmt: skip
    return batch, normal, present


def without(part: GaussianBatch, covered: np.ndarray) -> GaussianBatch:
    """Return Gaussians, those of a mask (n,) invisible."""
    return part._replace(opacity=np.where(covered, 0.0, part.opacity))


def _in_rows(surface: ShapeSurface, members: np.ndarray) -> ShapeSurface:
    """Return a surface whose particles are numbered as all are."""
    return surface._replace(parent=members[surface.parent], covered=members[surface.covered])


def _joined(surfaces: list[ShapeSurface]) -> ShapeSurface | None:
    """Return the surfaces as one, None if there are no Gaussians."""
    surfaces = [surface for surface in surfaces if len(surface.parent)]
    return ShapeSurface(*(np.concatenate(rows) for rows in zip(*surfaces))) if surfaces else None


def _shapes_of(look: Appearance) -> list[tuple[Any, np.ndarray] | None]:
    """Return the shape of each object, and its matrix (4, 4) to the domain; None without one."""
    try:
        records = {o.get("name"): o.get("shape") for o in look.run.scene.get("object", ())}
    except (AttributeError, TypeError):
        records = {}
    out: list[tuple[Any, np.ndarray] | None] = []
    for entry in look.objects:
        shape, matrix = _shape(records.get(entry.get("name"))), entry.get("transform")
        is_placed = shape is not None and matrix is not None
        out.append((shape, np.array(matrix, dtype=np.float64)) if is_placed else None)
    return out


def _shape(record: Any) -> Any:
    """Return a shape from its record in the scene, or None."""
    form = next((name for name in FORMS if isinstance(record, dict) and record.get(name)), None)
    if form is None:
        return None
    value = record[form]
    if form in COMPOUND:
        value = [_shape(part) for part in value]
        if any(part is None for part in value):
            return None
    elif isinstance(value, dict):
        value = SimpleNamespace(**value)
    return SimpleNamespace(
        **{"form": form, form: value, "blend_radius": record.get("blend_radius")}
    )


def _surface_of(shape: Any, matrix: np.ndarray, x0: np.ndarray, spacing: float) -> ShapeSurface:
    """Return the flat Gaussians of one body.

    Args:
        shape: Its shape.
        matrix: Transform from the shape's coordinates to the domain, shape (4, 4).
        x0: Its particles at rest, shape (n, 3) [m].
        spacing: Their spacing [m].
    """
    from scipy.spatial import cKDTree

    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    rotation, shift = matrix[:3, :3] / scale, matrix[:3, 3]

    def distance(points: np.ndarray) -> np.ndarray:
        """Return signed distances (n,) [m] of points of the domain."""
        out = np.empty(len(points))
        for begin in range(0, len(points), PART):
            part = slice(begin, begin + PART)
            local = (points[part] - shift) @ rotation / scale
            out[part] = scale * shape_distance.distance(shape, local)
        return out

    depth = -distance(x0)
    covered = np.flatnonzero((depth > 0) & (depth < COVERED * spacing))
    points = _lattice_near(x0[covered], spacing * GAP)
    points = points[np.abs(distance(points)) <= GAP * spacing]
    for _ in range(STEPS):
        points = points - distance(points)[:, None] * _slope(distance, points, STEP * spacing)
    slope = _slope(distance, points, STEP * spacing)
    size = np.linalg.norm(slope, axis=1)
    arrived = (np.abs(distance(points)) < ON_SURFACE * spacing) & (size > SMOOTH)
    points, normal = points[arrived], slope[arrived] / size[arrived, None]
    single = _first_of_equals(points, normal, 0.5 * GAP * spacing)
    points, normal = points[single], normal[single]
    cov = (WIDTH * spacing) ** 2 * pack_symmetric(
        np.eye(3) - (1.0 - FLATNESS**2) * normal[:, :, None] * normal[:, None, :]
    )
    moved, cov = surface_edges.cut_at_edges(points, normal, cov)
    parent = np.zeros(len(points), np.int64)
    if len(points):
        parent = covered[cKDTree(x0[covered]).query(points)[1]]
    return ShapeSurface(parent, points + moved - x0[parent], normal, cov, covered)


def _lattice_near(x: np.ndarray, gap: float) -> np.ndarray:
    """Return the points (m, 3) of a lattice of a gap [m] around points (n, 3)."""
    if not len(x):
        return x
    origin = x.min(axis=0) - 4.25 * gap
    base = np.floor((x - origin) / gap).astype(np.int64)
    shape = base.max(axis=0) + 6
    keys = np.ravel_multi_index(tuple(base.T), shape)
    for stride in (shape[1] * shape[2], shape[2], 1):  # one axis after the other
        keys = _sorted_once(np.add.outer(keys, stride * np.arange(-2, 3)).ravel())
    cells = np.stack(np.unravel_index(keys, shape), axis=1)
    return origin + gap * (cells + 0.5)


def _sorted_once(keys: np.ndarray) -> np.ndarray:
    """Return the different ones of some integers in ascending order; np.unique is slower."""
    keys = np.sort(keys)
    return keys[np.append(True, keys[1:] != keys[:-1])]


def _slope(distance, points: np.ndarray, step: float) -> np.ndarray:
    """Return the gradients (n, 3) of a distance by central differences."""
    out = np.empty_like(points)
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = step
        out[:, axis] = (distance(points + offset) - distance(points - offset)) / (2.0 * step)
    return out


def _first_of_equals(points: np.ndarray, normal: np.ndarray, size: float) -> np.ndarray:
    """Return rows of points, one of those in each cell of a size [m] whose normals agree."""
    key = np.concatenate([np.floor(points / size), np.round(2.0 * normal)], axis=1)
    return np.sort(np.unique(key.astype(np.int64), axis=0, return_index=True)[1])
