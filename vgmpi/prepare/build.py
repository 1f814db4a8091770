"""From a scene to its particles: objects are made one by one on one rank, checked and joined."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from vgmpi import room
from vgmpi.gaussians.checked import GaussianFileError
from vgmpi.planning.channels import SURFACE
from vgmpi.planning.colour_sets import colour_sets
from vgmpi.planning.groups import deforms, surfaced
from vgmpi.prepare import cost, inflow
from vgmpi.prepare.collider import Collider, ShapeCollider, moving
from vgmpi.prepare.courses import astray, leaves
from vgmpi.prepare.initial import begun
from vgmpi.prepare.loaded import Loaded, find
from vgmpi.prepare.mesh import MeshError
from vgmpi.prepare.motion import velocity
from vgmpi.prepare.outline import outlined
from vgmpi.prepare.passive import bound
from vgmpi.prepare.pieces import Piece, make
from vgmpi.prepare.place import PlacementError
from vgmpi.prepare.voxels import Voxels
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.sources import Inflow

log = logging.getLogger("vgmpi")

Pieces = list[Piece] | dict[int, Piece]  # by the row of their object


@dataclass(frozen=True)
class Scenery:
    """Gaussians that are only drawn: x (s, 3) [m], cov0 (s, 6) [m2], opacity (s,), sh (s, K, 3),
    object (s,), the row of each one's object in the scene, and shade (s,) as in Prepared."""

    x: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    object: np.ndarray
    shade: np.ndarray | None = None


@dataclass(frozen=True)
class Passive:
    """Gaussians without mass that ride along with particles: as Scenery, and carriers (s, 4), the
    ids of the particles that carry each, and their weights (s, 4)."""

    x: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    object: np.ndarray
    carriers: np.ndarray
    weights: np.ndarray
    shade: np.ndarray | None = None


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
    theta0: np.ndarray  # (n,) ln J at the start
    loads: list[Loaded]
    passive: Passive | None = None
    surface0: np.ndarray | None = None  # (n, 10) see planning/channels.py, where asked for
    shade: np.ndarray | None = None  # (n,) of the light painted on sh; None where it is 1 for all


def build(scene: Scene) -> Prepared:
    """Make all particles of a scene. Raises SceneError with all objects that cannot be made or do
    not fit into the memory, or loads that act on nothing."""
    cost.afford(scene)
    inflow.afford(scene)
    pieces: list[Piece] = []
    errors: list[tuple[tuple, str]] = []
    touched = surfaced(scene)
    for k, thing in enumerate(scene.object):
        try:
            piece = begun(scene, thing, make(scene, k))
            asked = thing.role == "body" and scene.phase_of(thing) in touched
            piece = replace(piece, collider=moving(piece.collider, thing.motion))
            pieces.append(outlined(scene, piece, asked))
            wrong = astray(scene, piece.collider) + leaves(scene, thing, piece.cloud.x)
            errors += [(("object", k, *key), said) for key, said in wrong]
            if piece.said:
                log.info("'%s': %s", thing.name, _told(scene, thing, piece))
        except PlacementError as error:
            errors.append((("object", k, error.key), str(error)))
        except (GaussianFileError, MeshError) as error:
            errors.append((("object", k, thing.source), str(error)))
        except room.TooLarge as error:
            errors.append((cost.key(scene, k), f"object '{thing.name}': {error}"))
    if errors:
        raise scene.error(errors)
    cost.fits(scene, {k: len(piece.cloud) for k, piece in enumerate(pieces)}, cost.JOINED)
    _warn_of_overlaps(scene, pieces)
    _warn_of_locking(scene)
    _tell_of_share(scene)
    inflow.check(scene, pieces, [p.collider for p in pieces if p.collider is not None])
    return _together(scene, [*pieces, *inflow.poured(scene)])


def _told(scene: Scene, thing: Object, piece: Piece) -> str:
    """What was made of a body, and what it weighs."""
    volume = float(piece.volume.sum())
    mass = scene.material[thing.material].bulk_density * volume
    return f"{piece.said}: {1e3 * volume:.3g} l, {mass:.3g} kg"


def _warn_of_overlaps(scene: Scene, pieces: list[Piece]) -> None:
    """Say which bodies share space: what is there twice is pushed apart violently."""
    spacing = scene.domain.cell / 2
    # those with a share of their space are meant to lie over each other
    bodies = [
        k
        for k, thing in enumerate(scene.object)
        if thing.role == "body" and thing.fraction == 1.0 and thing.fraction_profile is None
    ]
    if not bodies:
        return
    voxels = Voxels.around(np.concatenate([pieces[k].cloud.x for k in bodies]), spacing, margin=0)
    held = [np.unique(voxels.index(pieces[k].cloud.x)) for k in bodies]
    size = np.array([len(each) for each in held])
    place = np.unique(np.concatenate(held), return_inverse=True)[1].ravel()
    rows = np.repeat(np.arange(len(bodies)), size)
    has = sparse.csr_array((np.ones(len(rows), dtype=np.int64), (rows, place)))
    shared = sparse.triu(has @ has.T, k=1).tocsr()  # voxels of each pair that has any
    shared.sort_indices()
    one, other = shared.nonzero()
    for a, b, count in zip(one, other, shared.data, strict=True):
        if count > 0.02 * min(size[a], size[b]):
            log.warning(
                "'%s' and '%s' overlap by %.3g l: they will push each other apart",
                scene.object[bodies[a]].name,
                scene.object[bodies[b]].name,
                1e3 * count * spacing**3,
            )


def _warn_of_locking(scene: Scene) -> None:
    """Say which materials hardly change their volume: linear shapes in a cell cannot follow that
    when they bend."""
    for name, material in scene.material.items():
        ratio = getattr(material, "poisson_ratio", 0.0)
        if ratio > 0.45:
            log.warning("material '%s': poisson_ratio = %g is above 0.45: it will bend too stiffly",
                        name, ratio)  # fmt: skip


def _tell_of_share(scene: Scene) -> None:
    """What a share of FLIP in each step means, where it counts."""
    if scene.accuracy.keeps and scene.accuracy.flip is not None:
        log.info(
            "accuracy.flip = %g is kept in each step: the shorter the step, the more is lost;"
            " accuracy.damping is a time",
            scene.accuracy.flip,
        )


def _together(scene: Scene, pieces: list[Piece]) -> Prepared:
    bodies = [k for k, thing in enumerate(scene.things) if thing.role != "scenery"]
    decor = [k for k, thing in enumerate(scene.object) if thing.role == "scenery"]
    terms = max(piece.cloud.sh.shape[1] for piece in pieces)
    objects, first, sets = [], 0, colour_sets(scene)
    for k, thing in enumerate(scene.things):
        count = len(pieces[k].cloud) if thing.role != "scenery" else 0
        objects.append(_describe(scene, thing, pieces[k], sets[k], first, count))
        first += count
    scenery = None
    if decor:
        scenery = Scenery(
            x=_rows(pieces, decor, lambda p: p.cloud.x),
            **_looks(pieces, decor, terms),
            object=_owners(pieces, decor),
        )
    x = _rows(pieces, bodies, lambda p: p.cloud.x)
    vol0, owner = _rows(pieces, bodies, lambda p: p.volume), _owners(pieces, bodies)
    return Prepared(
        x=x,
        v0=np.concatenate([_velocity(scene, k, pieces[k]) for k in bodies]),
        vol0=vol0,
        object=owner,
        **_looks(pieces, bodies, terms),
        scenery=scenery,
        objects=objects,
        colliders=_colliders(scene, pieces, x),
        theta0=_rows(pieces, bodies, _theta),
        loads=find(scene, x, vol0, owner),
        passive=_riding(pieces, objects, terms),
        surface0=_surfaces(pieces, bodies),
    )


def _colliders(scene: Scene, pieces: list[Piece], x: np.ndarray) -> list[Collider]:
    """What bodies, whose particles are at x (n, 3) [m], collide with."""
    size, dx = np.array(scene.domain.size), scene.domain.cell
    return [
        one.around(x, size, dx) if isinstance(one, ShapeCollider) else one
        for one in (piece.collider for piece in pieces)
        if one is not None
    ]


def _velocity(scene: Scene, k: int, piece: Piece) -> np.ndarray:
    thing = scene.things[k]
    if isinstance(thing, Inflow):
        return inflow.velocity(scene, thing, len(piece.cloud))
    return velocity(thing, piece.cloud.x, piece.volume)


def _surfaces(pieces: list[Piece], bodies: list[int]) -> np.ndarray | None:
    """Surfaces of all bodies, zeros of those that have none; None where no body has one."""
    if all(pieces[k].surface is None for k in bodies):
        return None
    return _rows(pieces, bodies, _surface).astype(np.float32)


def _surface(piece: Piece) -> np.ndarray:
    return np.zeros((len(piece.cloud), SURFACE)) if piece.surface is None else piece.surface


def _riding(pieces: list[Piece], objects: list[dict[str, Any]], terms: int) -> Passive | None:
    """The passive Gaussians of all objects, bound to the particles of their own."""
    chosen = [k for k, piece in enumerate(pieces) if piece.passive is not None]
    riders = {k: replace(pieces[k], cloud=pieces[k].passive) for k in chosen}
    if not sum(len(rider.cloud) for rider in riders.values()):
        return None
    ties = [bound(pieces[k].cloud.x, riders[k].cloud.x) for k in chosen]
    return Passive(
        x=_rows(riders, chosen, lambda p: p.cloud.x),
        **_looks(riders, chosen, terms),
        object=_owners(riders, chosen),
        carriers=np.concatenate([objects[k]["first"] + t[0] for k, t in zip(chosen, ties)]),
        weights=np.concatenate([t[1] for t in ties]).astype(np.float32),
    )


def _describe(
    scene: Scene, thing: Object | Inflow, piece: Piece, colour_set: int | None, first: int,
    count: int,
) -> dict[str, Any]:  # fmt: skip
    """What files say about one object; JSON values."""
    material = scene.material[thing.material] if thing.material else None
    family = material.family if material else None
    return {
        "name": thing.name,
        "role": thing.role,
        "material": thing.material,
        "kind": material.kind if material else None,
        "family": family,
        "deforms": deforms(scene, thing),
        "phase": scene.phase_of(thing),
        "colour_set": colour_set,
        "density": material.bulk_density if material else None,
        "first": first,
        "count": count,
        "opacity_scale": thing.opacity_scale,
        "alpha_min": thing.drawn_from,
        "transform": piece.placement.matrix(),
        "color": list(thing.colour),
        "collider": thing.collider,
        "surface": piece.surface is not None,
    } | ({"moves": True} if thing.collider and thing.motion is not None else {})


def _theta(piece: Piece) -> np.ndarray:
    return np.zeros(len(piece.cloud)) if piece.theta is None else piece.theta


def _looks(pieces: Pieces, chosen: list[int], terms: int) -> dict[str, Any]:
    """Covariance, opacity, padded colour coefficients and the light on them, in single
    precision."""

    def padded(piece: Piece) -> np.ndarray:
        sh = piece.cloud.sh
        return np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0)))

    return {
        "cov0": _rows(pieces, chosen, lambda p: p.cloud.cov().astype(np.float32)),
        "opacity": _rows(pieces, chosen, lambda p: p.cloud.opacity.astype(np.float32)),
        "sh": _rows(pieces, chosen, padded),
        "shade": _shade(pieces, chosen),
    }


def _shade(pieces: Pieces, chosen: list[int]) -> np.ndarray | None:
    """Factors (n,) of the light painted on colours; None where all are 1."""
    if all(pieces[k].cloud.shade is None for k in chosen):
        return None
    found = _rows(pieces, chosen, lambda p: p.cloud.shades)
    return found if (found != 1).any() else None


def _rows(pieces: Pieces, chosen: list[int], part: Callable[[Piece], Any]) -> np.ndarray:
    return np.concatenate([part(pieces[k]) for k in chosen])


def _owners(pieces: Pieces, chosen: list[int]) -> np.ndarray:
    return np.repeat(np.array(chosen, dtype=np.int32), [len(pieces[k].cloud) for k in chosen])
