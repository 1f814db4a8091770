"""Objects that share space at the start: what is cut out of bodies, and warnings of the rest."""

import logging
from dataclasses import replace

import numpy as np
import scipy

from vgmpi.preprocess.sampling.voxels import Voxels
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features
from vgmpi.scene.subtraction import is_subtractable, subtracted_names

from .built_object import BuiltObject
from .collider_sdf import Collider
from .placement import PlacementError

log = logging.getLogger("vgmpi")

MIN_DEPTH_CELLS = 0.2  # [cells] depth of a particle in a collider from which an overlap is told
MIN_SHARED_FRACTION = 0.02  # [-] of the smaller body from which an overlap of two bodies is told
MAX_LINES = 8  # overlaps with colliders that have a line each
_MAX_POINTS = 500_000  # points that are evaluated together


def subtract_objects(scene: Scene, k: int, pieces: list[BuiltObject | None]) -> BuiltObject:
    """Return object `k` without the particles that lie inside the objects cut out of it.

    Args:
        scene: The scene.
        k: Row of the object.
        pieces: All objects as they are built, None in place of those that cannot be built.

    Raises:
        PlacementError: No particle is left.
    """
    obj, piece = scene.object[k], pieces[k]
    assert piece is not None
    for name in subtracted_names(obj, scene.object, scene.material):
        row = next(m for m, other in enumerate(scene.object) if other.name == name)
        other = pieces[row]
        solid = None if other is None else _surface_of(other)
        if solid is None:
            continue
        inside = _depths(solid, piece.cloud.x) > 0.0
        if inside.all():
            raise PlacementError("subtract", f"leaves no particle: all of it lies inside '{name}'")
        log.info("'%s': %s inside '%s' is cut out", obj.name, _amount(piece, inside), name)
        piece = _select(piece, ~inside)
    return piece


def _surface_of(piece: BuiltObject) -> Collider | None:
    """Return the signed distance of an object's surface, None if it has none."""
    if piece.collider is not None:
        return piece.collider
    return None if piece.surface_sdf is None else piece.surface_sdf()


def _depths(solid: Collider, x: np.ndarray) -> np.ndarray:
    """Return the depths (n,) [m] of points x (n, 3) [m] below a surface, 0 or less outside."""
    low, high = solid.ends()
    depth = np.zeros(len(x))
    close = np.flatnonzero(((x >= low) & (x <= high)).all(axis=1))
    for start in range(0, len(close), _MAX_POINTS):
        rows = close[start : start + _MAX_POINTS]
        depth[rows] = -solid.distance(x[rows])
    return depth


def _select(piece: BuiltObject, mask: np.ndarray) -> BuiltObject:
    """Return an object with some of its particles; mask: (n,) bool."""
    count = int(mask[: piece.surface_count].sum())
    return replace(piece.select(mask), surface_count=count)


def _amount(piece: BuiltObject, mask: np.ndarray) -> str:
    """Return text on the volume of some of an object's particles; mask: (n,) bool."""
    volume = 1e3 * float(piece.volume[mask].sum())
    return f"{volume:.3g} l ({mask.sum():,} of {len(mask):,} particles)"


def overlap_warnings(scene: Scene, pieces: list[BuiltObject]) -> list[str]:
    """Return a line for each two objects that share space at the start.

    What flows stays in the collider or rigid body in which it begins; bodies that share space are
    pushed apart violently.

    Args:
        scene: The scene.
        pieces: Its objects.
    """
    return _inside_colliders(scene, pieces) + _shared_by_bodies(scene, pieces)


def _inside_colliders(scene: Scene, pieces: list[BuiltObject]) -> list[str]:
    """Return a line for each body of particles that begins inside a collider or rigid body."""
    lines: list[str] = []
    for k, obj in enumerate(scene.object):
        # what holds or moves such a body may well lie in it
        is_exempt = obj.motion is not None or any(each.may_overlap(obj) for each in features())
        if obj.role != "body" or is_exempt:
            continue
        overlaps = []
        for m, other in enumerate(scene.object):
            solid = pieces[m].collider
            if solid is None:
                continue
            depth = _depths(solid, pieces[k].cloud.x)
            detail = solid.detail
            min_depth = MIN_DEPTH_CELLS if detail is None else detail.min_overlap_cells
            if depth.max(initial=0.0) > min_depth * scene.domain.cell:
                overlaps.append((other.name, _amount(pieces[k], depth > 0.0)))
        remedy = _remedy(scene, obj, [name for name, _ in overlaps])
        stays = "where it stays" if _flows(scene, obj) else "which pushes it out"
        lines += [
            f"'{obj.name}' begins with {amount} inside '{name}', {stays}{remedy}"
            for name, amount in overlaps
        ]
    more = len(lines) - MAX_LINES
    return lines[:MAX_LINES] + ([f"{more} more bodies begin inside others"] if more > 0 else [])


def _flows(scene: Scene, obj: Object) -> bool:
    """Return whether an object is a body of a liquid, a paste, sand or snow."""
    return obj.role == "body" and scene.material_of(obj).family != "solid"


def _remedy(scene: Scene, obj: Object, names: list[str]) -> str:
    """Return what to add to an object so that others are cut out of it, or an empty text.

    Args:
        scene: The scene.
        obj: Object of the scene.
        names: Names of the others.
    """
    if not _flows(scene, obj):
        return ""
    before = obj.subtract if isinstance(obj.subtract, tuple) else ()
    listed = ", ".join(f'"{name}"' for name in dict.fromkeys((*before, *names)))
    return f"; add to object '{obj.name}': subtract = [{listed}]"


def _shared_by_bodies(scene: Scene, pieces: list[BuiltObject]) -> list[str]:
    """Return a line for each two bodies of particles that share space."""
    spacing = scene.domain.cell / 2
    # Bodies with a volume fraction are meant to lie over each other.
    bodies = [
        k
        for k, obj in enumerate(scene.object)
        if obj.role == "body" and obj.volume_fraction == 1.0 and obj.volume_fraction_profile is None
    ]
    if not bodies:
        return []
    voxels = Voxels.enclosing(
        np.concatenate([pieces[k].cloud.x for k in bodies]), spacing, margin=0
    )
    voxels_of = [np.unique(voxels.index(pieces[k].cloud.x)) for k in bodies]
    size = np.array([len(each) for each in voxels_of])
    voxel = np.unique(np.concatenate(voxels_of), return_inverse=True)[1].ravel()
    rows = np.repeat(np.arange(len(bodies)), size)
    occupancy = scipy.sparse.csr_array((np.ones(len(rows), dtype=np.int64), (rows, voxel)))
    shared = scipy.sparse.triu(
        occupancy @ occupancy.T, k=1
    ).tocsr()  # number of shared voxels of each pair that has any
    shared.sort_indices()
    first, second = shared.nonzero()
    return [
        _shared_line(scene, bodies[a], bodies[b], count * spacing**3)
        for a, b, count in zip(first, second, shared.data, strict=True)
        if count > MIN_SHARED_FRACTION * min(size[a], size[b])
        and not _is_cut_out(scene, bodies[a], bodies[b])
    ]


def _is_cut_out(scene: Scene, a: int, b: int) -> bool:
    """Return whether one of two objects is cut out of the other: they share voxels, no space."""
    first, second = scene.object[a], scene.object[b]
    every = scene.object, scene.material
    return any(
        solid.name in subtracted_names(body, *every)
        for body, solid in ((first, second), (second, first))
    )


def _shared_line(scene: Scene, a: int, b: int, volume: float) -> str:
    """Return the line on two bodies that share a volume [m3]."""
    first, second = scene.object[a], scene.object[b]
    remedy = ""
    for body, solid in ((first, second), (second, first)):
        if _flows(scene, body) and is_subtractable(solid, scene.material):
            remedy = _remedy(scene, body, [solid.name])
    return (
        f"'{first.name}' and '{second.name}' overlap by {1e3 * volume:.3g} l: they will push each"
        f" other apart{remedy}"
    )


def warn_of_overlaps(scene: Scene, pieces: list[BuiltObject]) -> tuple[str, ...]:
    """Warn of objects that share space at the start; return the lines."""
    lines = overlap_warnings(scene, pieces)
    for line in lines:
        log.warning("%s", line)
    return tuple(lines)
