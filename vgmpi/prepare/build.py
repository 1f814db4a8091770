"""From a scene to its particles: every object is made, placed, filled and checked, on one rank."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vgmpi.gaussians import ply
from vgmpi.gaussians.cloud import Cloud
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.objects import Object
from vgmpi.prepare import fill, mesh, shapes
from vgmpi.prepare.collider import Collider, ShapeCollider, VoxelCollider
from vgmpi.prepare.place import Placement, PlacementError, place, turn
from vgmpi.prepare.select import selected
from vgmpi.prepare.voxels import Voxels, volumes
from vgmpi.scene import Scene, phase_of

log = logging.getLogger("vgmpi")

LIGHT = np.array([0.36, -0.48, 0.80])  # unit vector towards the painted light
_BALL = (3 / (4 * np.pi)) ** (1 / 3)  # radius of a ball of volume 1


@dataclass(frozen=True)
class Scenery:
    """Gaussians that are only drawn: x (s, 3) [m], cov0 (s, 6) [m2], opacity (s,), sh (s, K, 3)
    and object (s,), the row of each one's object in the scene."""

    x: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    object: np.ndarray


@dataclass(frozen=True)
class Prepared:
    """All particles of a scene; row number is particle id, rows of one object are contiguous.

    x (n, 3) [m] and v0 (n, 3) [m/s] in double; vol0 (n,) rest volumes [m3]; object (n,) int32 rows
    of `objects`; cov0 (n, 6) [m2], opacity (n,) and sh (n, K, 3) single, K the largest of any
    object, zero where an object has fewer. objects: one dict per object of the scene (scenery too).
    """

    x: np.ndarray
    v0: np.ndarray
    vol0: np.ndarray
    object: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    scenery: Scenery | None
    objects: list[dict[str, Any]]
    colliders: list[Collider]


@dataclass(frozen=True)
class Piece:
    """One object in the domain: its Gaussians, their volumes [m3], and what placed it."""

    cloud: Cloud
    volume: np.ndarray
    placement: Placement
    collider: Collider | None = None


def build(scene: Scene) -> Prepared:
    """Make all particles of a scene. Raises SceneError with all objects that cannot be made."""
    pieces: list[Piece] = []
    errors: list[tuple[tuple, str]] = []
    for k, thing in enumerate(scene.object):
        try:
            piece = _MAKE[thing.source](scene, k, thing)
            if thing.role == "body":  # fillings and samples too
                _inside(scene, thing, piece.cloud.x.min(axis=0), piece.cloud.x.max(axis=0), 0.0)
            pieces.append(piece)
        except PlacementError as error:
            errors.append((("object", k, error.key), str(error)))
        except (ply.GaussianFileError, mesh.MeshError) as error:
            errors.append((("object", k, thing.source), str(error)))
    if errors:
        raise scene.error(errors)
    _warn_of_overlaps(scene, pieces)
    return _together(scene, pieces)


def _from_shape(scene: Scene, k: int, thing: Object) -> Piece:
    shape, spacing = thing.shape, _spacing(scene, thing)
    at = place(thing, lambda d: shapes.reach(shape, d))
    low, high = _corners(at, lambda d: shapes.reach(shape, d))
    if thing.role == "body":
        _inside(scene, thing, low, high, 1e-6 * spacing)  # before a huge lattice is searched

    def wanted(points: np.ndarray) -> np.ndarray:
        deep = at.scale * shapes.distance(shape, at.own(points))
        return (deep < 0) & (deep > -1.01 * spacing) if thing.role == "scenery" else deep < 0

    x = shapes.lattice(wanted, low, high, spacing)
    if not len(x):
        said = f"too small or thin: no particle fits in, their spacing is {spacing:g} m"
        raise PlacementError("shape", said)
    own = at.own(x)
    rgb = shapes.colors(shape, own, thing.color)
    if not _is_fluid(scene, thing):
        normal = shapes.normals(shape, own, 0.5 * spacing / at.scale)
        rgb = shaded(rgb, turn(at.rotation, normal), scene.appearance.shade)
    collider = ShapeCollider(thing.name, shape, at, spacing / 2) if thing.collider else None
    return Piece(
        round_cloud(x, spacing, rgb, thing.opacity), np.full(len(x), spacing**3), at, collider
    )


def _from_mesh(scene: Scene, k: int, thing: Object) -> Piece:
    spacing = _spacing(scene, thing)
    found = mesh.read(scene.files[thing.name])
    at = place(thing, lambda d: float((found.points @ d).max()))
    placed = mesh.Mesh(at.points(found.points), found.triangles, found.rgb)
    if thing.role == "body":
        low, high = placed.points.min(axis=0), placed.points.max(axis=0)
        _inside(scene, thing, low, high, 1e-6 * spacing)
    surface = mesh.sample(placed, spacing, thing.color, thing.opacity, [scene.seed, k])
    normal = mesh.normals(surface)
    rgb = shaded(surface.rgb, normal, 0.0 if _is_fluid(scene, thing) else scene.appearance.shade)
    surface.sh[:, 0] = dc_from_rgb(rgb)
    if thing.role == "scenery" and not thing.collider:
        return Piece(surface, np.zeros(len(surface)), at)
    inner = shapes.lattice(
        lambda points: mesh.inside(placed, points, spacing),
        placed.points.min(axis=0),
        placed.points.max(axis=0),
        spacing,
    )
    return _solid(scene, thing, surface, inner, np.empty((0, 3)), at)


def _from_gaussians(scene: Scene, k: int, thing: Object) -> Piece:
    spacing = _spacing(scene, thing)
    cloud = selected(ply.read(scene.files[thing.name]), thing.select)
    if not len(cloud):
        raise PlacementError("select", "selects no Gaussian of the file")
    at = place(thing, lambda d: float((cloud.x @ d).max()))
    cloud = at.cloud(cloud)
    if thing.role == "scenery" and not thing.collider:
        return Piece(cloud, np.zeros(len(cloud)), at)
    if thing.role == "body":
        _inside(scene, thing, cloud.x.min(axis=0), cloud.x.max(axis=0), 0.0)
    try:
        inner, gaps = fill.interior(cloud, spacing, thing.fill)
    except fill.TooLarge as error:
        raise PlacementError("fill", str(error)) from None
    return _solid(scene, thing, cloud, inner, gaps, at)


_MAKE: dict[str, Callable[[Scene, int, Object], Piece]] = {
    "shape": _from_shape,
    "mesh": _from_mesh,
    "gaussians": _from_gaussians,
}


def _solid(
    scene: Scene, thing: Object, surface: Cloud, inner: np.ndarray, gaps: np.ndarray, at: Placement
) -> Piece:
    """A surface and lattice points inside and on it: as a body, or as scenery that others hit."""
    spacing = _spacing(scene, thing)
    shell = np.concatenate([surface.x, gaps])
    voxels = Voxels.around(np.concatenate([shell, inner]), spacing)
    inner = inner[~np.isin(voxels.index(inner), voxels.index(shell))]
    if thing.role == "scenery":
        solid = np.zeros(voxels.shape, dtype=bool)
        solid.ravel()[voxels.index(np.concatenate([shell, inner]))] = True
        collider = VoxelCollider.of(thing.name, voxels, solid)
        return Piece(surface, np.zeros(len(surface)), at, collider)
    # what covers the gaps is drawn already, so their particles carry mass only
    unseen = fill.filling(gaps, surface, spacing, 0.0)
    filled = fill.filling(inner, surface, spacing, thing.opacity)
    cloud = fill.joined(fill.joined(surface, unseen), filled)
    return Piece(cloud, volumes(shell, inner, spacing, thing.fill is not False), at)


def round_cloud(x: np.ndarray, spacing: float, rgb: np.ndarray, opacity: float) -> Cloud:
    """Round Gaussians at lattice points (n, 3), as large as the ball of a lattice cell's volume."""
    n = len(x)
    return Cloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        np.full((n, 3), _BALL * spacing),
        np.full(n, opacity),
        dc_from_rgb(rgb)[:, None, :].astype(np.float32),
    )


def shaded(rgb: np.ndarray, normal: np.ndarray, amount: float) -> np.ndarray:
    """Colours (n, 3) darkened by up to `amount` where the surface faces away from the light.

    Gaussians carry no lights: without this a plain body is a flat silhouette.
    """
    facing = 0.5 + 0.5 * (normal * LIGHT).sum(axis=1)
    return rgb * (1.0 - amount * (1.0 - facing))[:, None]


def _spacing(scene: Scene, thing: Object) -> float:
    """Distance [m] of particles on the lattice."""
    return scene.domain.cell / round(thing.particles_per_cell ** (1 / 3))


def _is_fluid(scene: Scene, thing: Object) -> bool:
    return thing.role == "body" and scene.material[thing.material].family == "fluid"


def _corners(at: Placement, reach: Callable[[np.ndarray], float]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of an object in the domain."""
    high = at.scale * np.array([reach(row) for row in at.rotation]) + at.shift
    low = -at.scale * np.array([reach(-row) for row in at.rotation]) + at.shift
    return low, high


def _inside(scene: Scene, thing: Object, low: np.ndarray, high: np.ndarray, slack: float) -> None:
    """Raises PlacementError where an object reaches out of the domain by more than `slack` [m]."""
    size = np.asarray(scene.domain.size)
    out = []
    for axis, name in enumerate("xyz"):
        if low[axis] < -slack or high[axis] > size[axis] + slack:
            reaches = f"{name} = {low[axis]:.4g} .. {high[axis]:.4g} m"
            out.append(f"it reaches {reaches}, the domain 0 .. {size[axis]:g} m")
    if out:
        key = "position" if thing.position is not None else "origin"
        key = key if getattr(thing, key) is not None else thing.source
        raise PlacementError(key, f"the object lies outside the domain: {'; '.join(out)}")


def _warn_of_overlaps(scene: Scene, pieces: list[Piece]) -> None:
    """Say which bodies share space: what is there twice is pushed apart violently."""
    spacing = scene.domain.cell / 2
    bodies = [k for k, thing in enumerate(scene.object) if thing.role == "body"]
    if not bodies:
        return
    voxels = Voxels.around(np.concatenate([pieces[k].cloud.x for k in bodies]), spacing, margin=0)
    held = {k: np.unique(voxels.index(pieces[k].cloud.x)) for k in bodies}
    for at, a in enumerate(bodies):
        for b in bodies[at + 1 :]:
            shared = len(np.intersect1d(held[a], held[b], assume_unique=True))
            if shared > 0.02 * min(len(held[a]), len(held[b])):
                log.warning(
                    "'%s' and '%s' overlap by %.3g l: they will push each other apart",
                    scene.object[a].name,
                    scene.object[b].name,
                    1e3 * shared * spacing**3,
                )


def _together(scene: Scene, pieces: list[Piece]) -> Prepared:
    bodies = [k for k, thing in enumerate(scene.object) if thing.role == "body"]
    decor = [k for k, thing in enumerate(scene.object) if thing.role == "scenery"]
    terms = max(piece.cloud.sh.shape[1] for piece in pieces)
    objects, first = [], 0
    for k, thing in enumerate(scene.object):
        count = len(pieces[k].cloud) if thing.role == "body" else 0
        objects.append(_describe(scene, thing, pieces[k], first, count))
        first += count
    scenery = None
    if decor:
        scenery = Scenery(
            x=_rows(pieces, decor, lambda p: p.cloud.x),
            **_looks(pieces, decor, terms),
            object=_owners(pieces, decor),
        )
    return Prepared(
        x=_rows(pieces, bodies, lambda p: p.cloud.x),
        v0=np.concatenate([_velocity(scene.object[k], pieces[k]) for k in bodies]),
        vol0=_rows(pieces, bodies, lambda p: p.volume),
        object=_owners(pieces, bodies),
        **_looks(pieces, bodies, terms),
        scenery=scenery,
        objects=objects,
        colliders=[piece.collider for piece in pieces if piece.collider is not None],
    )


def _describe(scene: Scene, thing: Object, piece: Piece, first: int, count: int) -> dict[str, Any]:
    """What files say about one object; JSON values."""
    material = scene.material[thing.material] if thing.material else None
    family = material.family if material else None
    return {
        "name": thing.name,
        "role": thing.role,
        "material": thing.material,
        "kind": material.kind if material else None,
        "family": family,
        "phase": phase_of(thing, family) if family else None,
        "density": material.density if material else None,
        "first": first,
        "count": count,
        "opacity_scale": thing.opacity_scale,
        "alpha_min": thing.drawn_from,
        "transform": piece.placement.matrix(),
        "color": list(thing.color),
        "collider": thing.collider,
    }


def _velocity(thing: Object, piece: Piece) -> np.ndarray:
    """Velocities [m/s] (n, 3): a translation and a turn about the centre of mass."""
    x, share = piece.cloud.x, piece.volume / piece.volume.sum()
    middle = (x * share[:, None]).sum(axis=0)
    return np.asarray(thing.velocity) + np.cross(np.asarray(thing.spin), x - middle)


def _looks(pieces: list[Piece], chosen: list[int], terms: int) -> dict[str, np.ndarray]:
    """Covariance, opacity and padded colour coefficients, in single precision."""

    def padded(piece: Piece) -> np.ndarray:
        sh = piece.cloud.sh
        return np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0)))

    return {
        "cov0": _rows(pieces, chosen, lambda p: p.cloud.cov().astype(np.float32)),
        "opacity": _rows(pieces, chosen, lambda p: p.cloud.opacity.astype(np.float32)),
        "sh": _rows(pieces, chosen, padded),
    }


def _rows(pieces: list[Piece], chosen: list[int], part: Callable[[Piece], Any]) -> np.ndarray:
    return np.concatenate([part(pieces[k]) for k in chosen])


def _owners(pieces: list[Piece], chosen: list[int]) -> np.ndarray:
    return np.repeat(np.array(chosen, dtype=np.int32), [len(pieces[k].cloud) for k in chosen])
