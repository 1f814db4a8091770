"""Builder of a scene's particles: makes its objects on one rank, checks and joins them."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from vgmpi.gaussians.capture_conventions import render_model
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.planning.particle_channels import SURFACE
from vgmpi.planning.phases_and_groups import color_sets, phases_with_surface, stores_deformation
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.runtime import process_limits
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import InitialParticles, ParticleSource, features, prepare_features

from . import memory_estimate
from .body_regions import (
    particle_masses,
    region_entries,
    sort_by_region,
    validate_region_particles,
)
from .built_object import BuiltObject, bind_passive, with_surface_descriptor
from .collider_sdf import Collider, ShapeCollider, with_motion
from .initial_conditions import apply_initial_conditions, initial_velocity
from .initial_overlaps import subtract_objects, warn_of_overlaps
from .motion_checks import (
    validate_body_motion,
    validate_collider_motion,
)
from .object_builder import build_object
from .placement import PlacementError
from .setting_checks import warn_of_locking, warn_of_unlikely_objects

log = logging.getLogger("vgmpi")

Pieces = list[BuiltObject] | dict[int, BuiltObject]  # by row of the object


@dataclass(frozen=True)
class Scenery:
    """Gaussians that are only drawn.

    x (s, 3) [m], cov0 (s, 6) [m2], opacity (s,), sh (s, K, 3), object (s,), the row of each one's
    object in the scene, and shade (s,) as in `PreparedScene`.
    """

    x: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    object: np.ndarray
    shade: np.ndarray | None = None


@dataclass(frozen=True)
class Passive:
    """Gaussians without mass that are carried by particles.

    The fields are those of `Scenery`, and carriers (s, 4), the ids of the particles that carry
    each, with their weights (s, 4).
    """

    x: np.ndarray
    cov0: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    object: np.ndarray
    carriers: np.ndarray
    weights: np.ndarray
    shade: np.ndarray | None = None


@dataclass(frozen=True)
class PreparedScene:
    """Particles of a scene; row number is particle id, rows of one object are contiguous.

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
    passive: Passive | None = None
    surface0: np.ndarray | None = (
        None  # (n, 10) see planning/particle_channels.py, None if not needed
    )
    shade: np.ndarray | None = None  # (n,) factors of the light painted on sh; None if all are 1
    features: dict[str, Any] = field(default_factory=dict)  # prepared data of features, by name
    warnings: tuple[str, ...] = ()  # lines on objects that share space


def build_scene(scene: Scene) -> PreparedScene:
    """Make all particles of a scene.

    Raises:
        SceneError: All objects that cannot be made or do not fit into the memory, and what features
            cannot prepare.
    """
    memory_estimate.require_memory_for_shapes(scene)
    for feature in features():
        feature.check_memory(scene)
    errors: list[tuple[tuple, str]] = []
    built = [
        _attempt(scene, k, partial(_build, scene, k), errors) for k in range(len(scene.object))
    ]
    touched = phases_with_surface(scene)
    completed = [
        piece and _attempt(scene, k, partial(_complete, scene, k, built, touched, errors), errors)
        for k, piece in enumerate(built)
    ]
    if errors:
        raise scene.error(errors)
    pieces = [piece for piece in completed if piece is not None]
    memory_estimate.require_particle_memory(
        scene,
        {k: len(piece.cloud) for k, piece in enumerate(pieces)},
        memory_estimate.BYTES_PER_PARTICLE_MERGED,
    )
    warnings = warn_of_overlaps(scene, pieces)
    warn_of_locking(scene)
    warn_of_unlikely_objects(scene, pieces)
    colliders = [piece.collider for piece in pieces if piece.collider is not None]
    for feature in features():
        errors += feature.check_bodies(scene, pieces, colliders)
    if errors:
        raise scene.error(errors)
    sources = [source for feature in features() for source in feature.build_particles(scene)]
    joined = _join(scene, [*pieces, *sources])
    return replace(joined, warnings=warnings)


def _attempt(
    scene: Scene, k: int, build: Callable[[], BuiltObject], errors: list[tuple[tuple, str]]
) -> BuiltObject | None:
    """Return what `build` makes of object k, or None after its error is noted.

    Args:
        scene: The scene.
        k: Row of the object.
        build: Function without arguments.
        errors: Errors as (path, message) (in/out).
    """
    obj = scene.object[k]
    try:
        return build()
    except PlacementError as error:
        errors.append((("object", k, error.key), str(error)))
    except (GaussianFileError, MeshError) as error:
        errors.append((("object", k, obj.source), str(error)))
    except process_limits.InsufficientMemoryError as error:
        errors.append((memory_estimate.key(scene, k), f"object '{obj.name}': {error}"))
    return None


def _build(scene: Scene, k: int) -> BuiltObject:
    """Return object k by itself, with its collider."""
    obj, piece = scene.object[k], build_object(scene, k)
    cell, size = scene.domain.cell, scene.domain.size
    collider = with_motion(piece.collider, obj.motion)
    for feature in features() if collider is not None else ():
        collider = feature.complete_collider(obj, collider, cell, size)
    return replace(piece, collider=collider)


def _complete(
    scene: Scene, k: int, built: list[BuiltObject | None], touched: frozenset[str],
    errors: list[tuple[tuple, str]],
) -> BuiltObject:  # fmt: skip
    """Return object k with its initial state, after others are cut out of it.

    Args:
        scene: The scene.
        k: Row of the object.
        built: All objects by themselves.
        touched: Phases of which contact knows the surface.
        errors: Errors as (path, message) (in/out).
    """
    obj = scene.object[k]
    piece = apply_initial_conditions(scene, obj, subtract_objects(scene, k, built))
    piece = sort_by_region(scene, obj, piece)
    needed = obj.role == "body" and scene.phase_of(obj) in touched
    piece = with_surface_descriptor(scene, piece, needed)
    invalid = validate_collider_motion(scene, piece.collider)
    invalid += validate_body_motion(scene, obj, piece.cloud.x)
    for feature in features() if piece.collider is not None else ():
        invalid += feature.check_collider(scene, piece.collider)
    invalid += validate_region_particles(scene, obj, piece)
    errors += [(("object", k, *key), message) for key, message in invalid]
    if piece.summary:
        log.info("'%s': %s", obj.name, _object_summary(scene, obj, piece))
    return piece


def _object_summary(scene: Scene, obj: Object, piece: BuiltObject) -> str:
    """Return text on a body: particles, volume [l] and mass [kg]."""
    volume = float(piece.volume.sum())
    mass = scene.material_of(obj).bulk_density * volume
    if piece.region_counts:
        mass = float(particle_masses(scene, obj, piece).sum())
    return f"{piece.summary}: {1e3 * volume:.3g} l, {mass:.3g} kg"


def _join(scene: Scene, pieces: list[BuiltObject]) -> PreparedScene:
    """Return the particles of all objects and particle sources, joined."""
    bodies = [k for k, entity in enumerate(scene.entities) if entity.role != "scenery"]
    scenery_rows = [k for k, entity in enumerate(scene.object) if entity.role == "scenery"]
    terms = max(piece.cloud.sh.shape[1] for piece in pieces)
    objects, first_id, sets = [], 0, color_sets(scene)
    for k, entity in enumerate(scene.entities):
        count = len(pieces[k].cloud) if entity.role != "scenery" else 0
        objects.append(_describe(scene, entity, pieces[k], sets[k], first_id, count))
        first_id += count
    scenery = None
    if scenery_rows:
        scenery = Scenery(
            x=_rows(pieces, scenery_rows, lambda p: p.cloud.x),
            **_appearance(pieces, scenery_rows, terms),
            object=_owners(pieces, scenery_rows),
        )
    x = _rows(pieces, bodies, lambda p: p.cloud.x)
    vol0, owner = _rows(pieces, bodies, lambda p: p.volume), _owners(pieces, bodies)
    colliders = _colliders(scene, pieces, x)
    appearance = _appearance(pieces, bodies, terms)
    particles = InitialParticles(x, vol0, owner, objects, appearance["sh"])
    features, colliders = prepare_features(scene, particles, colliders)
    return PreparedScene(
        x=x,
        v0=np.concatenate([np.zeros((0, 3)), *(_velocity(scene, k, pieces[k]) for k in bodies)]),
        vol0=vol0,
        object=owner,
        **appearance,
        scenery=scenery,
        objects=objects,
        colliders=colliders,
        theta0=_rows(pieces, bodies, _theta),
        passive=_passive_gaussians(pieces, objects, terms),
        surface0=_surfaces(pieces, bodies),
        features=features,
    )


def _colliders(scene: Scene, pieces: list[BuiltObject], x: np.ndarray) -> list[Collider]:
    """Return the colliders; particles of bodies are at x (n, 3) [m]."""
    size, dx = np.array(scene.domain.size), scene.domain.cell
    return [
        collider.without_outer_side(x, size, dx)
        if isinstance(collider, ShapeCollider)
        else collider
        for collider in (piece.collider for piece in pieces)
        if collider is not None
    ]


def _velocity(scene: Scene, k: int, piece: BuiltObject) -> np.ndarray:
    """Return the initial velocities (n, 3) [m/s] of one object or particle source."""
    entity = scene.entities[k]
    if isinstance(entity, ParticleSource):
        assert piece.velocity is not None
        return piece.velocity
    weights = particle_masses(scene, entity, piece) if piece.region_counts else piece.volume
    return initial_velocity(entity, piece.cloud.x, weights, piece.velocity)


def _surfaces(pieces: list[BuiltObject], bodies: list[int]) -> np.ndarray | None:
    """Return the surface descriptors of all bodies, zeros where there is none; None without any."""
    if all(pieces[k].surface_descriptor is None for k in bodies):
        return None
    return _rows(pieces, bodies, _surface).astype(np.float32)


def _surface(piece: BuiltObject) -> np.ndarray:
    """Return the surface descriptors (n, 10) of one object, zeros where it has none."""
    if piece.surface_descriptor is None:
        return np.zeros((len(piece.cloud), SURFACE))
    return piece.surface_descriptor


def _passive_gaussians(
    pieces: list[BuiltObject], objects: list[dict[str, Any]], terms: int
) -> Passive | None:
    """Return the passive Gaussians of all objects, bound to the particles of their object."""
    riders = {
        k: replace(piece, cloud=piece.passive)
        for k, piece in enumerate(pieces)
        if piece.passive is not None
    }
    chosen = list(riders)
    if not sum(len(rider.cloud) for rider in riders.values()):
        return None
    bindings = [bind_passive(pieces[k].cloud.x, riders[k].cloud.x) for k in chosen]
    return Passive(
        x=_rows(riders, chosen, lambda p: p.cloud.x),
        **_appearance(riders, chosen, terms),
        object=_owners(riders, chosen),
        carriers=np.concatenate([objects[k]["first_row"] + t[0] for k, t in zip(chosen, bindings)]),
        weights=np.concatenate([t[1] for t in bindings]).astype(np.float32),
    )


def _describe(
    scene: Scene, entity: Object | ParticleSource, piece: BuiltObject, color_group: int | None,
    first: int, count: int,
) -> dict[str, Any]:  # fmt: skip
    """Return the entry of one object in output files, as JSON values.

    Args:
        scene: The scene.
        entity: Object or particle source.
        piece: Its particles.
        color_group: Number of its set of bodies that exchange colors.
        first: Id of its first particle.
        count: Number of its particles.
    """
    regions = region_entries(scene, entity, piece, first) if isinstance(entity, Object) else []
    is_moving = entity.collider and (entity.motion or entity.free_body) is not None
    material = scene.material[entity.material] if entity.material else None
    model = render_model(piece.cloud)
    family = material.family if material else None
    return (
        {
            "name": entity.name,
            "role": entity.role,
            "material": entity.material,
            "kind": material.kind if material else None,
            "family": family,
            "tracks_deformation": stores_deformation(scene, entity),
            "phase": scene.phase_of(entity),
            "color_group": color_group,
            "density": material.bulk_density if material else None,
            "first_row": first,
            "row_count": count,
            "opacity_scale": entity.opacity_scale,
            "alpha_min": entity.alpha_threshold,
            "transform": piece.placement.matrix(),
            "color": list(entity.color),
            "collider": entity.collider,
            "surface": piece.surface_descriptor is not None,
        }
        | ({"is_moving": True} if is_moving else {})
        | ({"render_model": model} if model != "classic" else {})
        | ({"regions": regions} if regions else {})
    )


def _theta(piece: BuiltObject) -> np.ndarray:
    """Return ln J (n,) at the start."""
    return np.zeros(len(piece.cloud)) if piece.theta is None else piece.theta


def _appearance(pieces: Pieces, chosen: list[int], terms: int) -> dict[str, Any]:
    """Return covariance, opacity, padded color coefficients and baked light as float32."""

    def padded(piece: BuiltObject) -> np.ndarray:
        """Return the coefficients with zeros up to `terms`."""
        sh = piece.cloud.sh
        return np.pad(sh, ((0, 0), (0, terms - sh.shape[1]), (0, 0)))

    return {
        "cov0": _rows(pieces, chosen, lambda p: p.cloud.cov().astype(np.float32)),
        "opacity": _rows(pieces, chosen, lambda p: p.cloud.opacity.astype(np.float32)),
        "sh": _rows(pieces, chosen, padded),
        "shade": _shade(pieces, chosen),
    }


def _shade(pieces: Pieces, chosen: list[int]) -> np.ndarray | None:
    """Return the factors (n,) of the baked light; None if all are 1."""
    if all(pieces[k].cloud.shade is None for k in chosen):
        return None
    shade = _rows(pieces, chosen, lambda p: p.cloud.shades)
    return shade if (shade != 1).any() else None


def _rows(pieces: Pieces, chosen: list[int], part: Callable[[BuiltObject], Any]) -> np.ndarray:
    """Return an array of several objects, joined; no rows of any object if none is chosen."""
    return np.concatenate([part(pieces[k]) for k in chosen or [0]])[: None if chosen else 0]


def _owners(pieces: Pieces, chosen: list[int]) -> np.ndarray:
    """Return the row of the object (n,) of each particle."""
    return np.repeat(np.array(chosen, dtype=np.int32), [len(pieces[k].cloud) for k in chosen])
