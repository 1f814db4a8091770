"""Particles reserved for inlets, behind those of the objects, and checks of inlet positions."""

from collections.abc import Iterator

import numpy as np

from vgmpi.gaussians.shape_distance import distance
from vgmpi.planning.phases_and_groups import phases_with_surface
from vgmpi.preprocess import memory_estimate
from vgmpi.preprocess.built_object import BuiltObject, isotropic_gaussians
from vgmpi.preprocess.collider_sdf import Collider
from vgmpi.preprocess.placement import SimilarityTransform
from vgmpi.preprocess.shape_sdf import contains
from vgmpi.runtime import process_limits
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import Errors

from . import geometry
from .plan import inlet_speed, outlet_plans, particle_count
from .table import Inlet

POINTS_PER_LAYER = 4  # points per layer at which a nozzle is checked


def require_inlet_memory(scene: Scene) -> None:
    """Raise SceneError if an inlet's particles cannot fit into the memory, or none would come."""
    bytes_each, dx = (
        memory_estimate.BYTES_PER_PARTICLE["body"]
        + memory_estimate.BYTES_PER_PARTICLE_MERGED["body"],
        scene.domain.cell,
    )
    for k, source in enumerate(scene.lists["inlet"]):
        per_layer = geometry.per_layer(source, dx)
        try:
            process_limits.require_memory(
                per_layer * bytes_each, f"a layer of inlet '{source.name}' has at least"
            )
            count = particle_count(scene, source)
            message = f"inlet '{source.name}' makes {count:.3g} particles until it ends: at least"
            process_limits.require_memory(count * bytes_each, message)
        except process_limits.InsufficientMemoryError as error:
            raise scene.error([(("inlet", k), str(error))]) from None
        if not count:
            message = "nothing comes: it ends before the first particle has passed its mouth"
            raise scene.error(
                [(("inlet", k, "end_time" if source.end_time else "start_time"), message)]
            )


def reserve_inlet_particles(scene: Scene) -> list[BuiltObject]:
    """Return all particles that may come out of each inlet, at its mouth, as they pass it."""
    dx, identity = scene.domain.cell, SimilarityTransform(np.eye(3), 1.0, np.zeros(3))
    reserved = []
    for source in scene.lists["inlet"]:
        h = geometry.spacing(source, dx)
        x = np.resize(geometry.inlet_points(source, dx), (particle_count(scene, source), 3))
        rgb = np.tile(np.asarray(source.color, float), (len(x), 1))
        cloud = isotropic_gaussians(x, h, rgb, source.opacity)
        velocity = np.tile(inlet_speed(scene, source) * np.array(source.direction), (len(x), 1))
        volume = np.full(len(x), h**3)
        reserved.append(BuiltObject(cloud, volume, identity, velocity=velocity))
    return reserved


def validate_inlets_outlets(
    scene: Scene, pieces: list[BuiltObject], colliders: list[Collider]
) -> Errors:
    """Return the errors of inlets and outlets in invalid positions.

    Args:
        scene: The scene.
        pieces: Particles of the objects.
        colliders: Colliders at the start.
    """
    bodies = {
        obj.name: piece.cloud.x
        for obj, piece in zip(scene.object, pieces, strict=True)
        if obj.role == "body"
    }
    errors: Errors = []
    for k, source in enumerate(scene.lists["inlet"]):
        points = _nozzle(source, scene.domain.cell)
        complaints = [*_solid(scene, source), *_blocked(scene, k, points, bodies, colliders)]
        errors += [
            (("inlet", k, key), line) for key, line in complaints[:1]
        ]  # one error per inlet is enough
    initial = [(k, sink) for k, sink in enumerate(outlet_plans(scene)) if not sink.since]
    for k, sink in initial:
        overlapping = [
            name for name, x in bodies.items() if contains(sink.shape, x, scene.domain.cell).any()
        ]
        if overlapping:
            message = f"'{sink.name}' holds particles of '{overlapping[0]}'"
            wall = k >= len(scene.lists["outlet"])
            advice = "" if wall else "; start_time opens it later"
            message = f"an outlet that removes a body at the start: {message}{advice}"
            errors.append((("domain", "boundary") if wall else ("outlet", k, "shape"), message))
    return errors


def _solid(scene: Scene, source: Inlet) -> Iterator[tuple[str, str]]:
    """Yield (key, message) for an inlet of a solid whose surface takes part in contact."""
    if scene.phase_of(source) in phases_with_surface(scene):
        yield (
            "material",
            f"{source.material!r} is a solid, of which contact knows the surface, and something may"
            " touch it: only liquids, pastes, sand and snow can pour here",
        )


def _blocked(
    scene: Scene, k: int, points: np.ndarray, bodies: dict, colliders: list[Collider]
) -> Iterator[tuple[str, str]]:
    """Yield (key, message) for obstacles in the nozzle of inlet k.

    Args:
        scene: The scene.
        k: Row of the inlet.
        points: Points all through the nozzle, shape (m, 3) [m].
        bodies: Particle positions of bodies by name.
        colliders: Colliders at the start.
    """
    source, dx = scene.lists["inlet"][k], scene.domain.cell
    key, within = source.opening_kind, -geometry.TOUCH_TOLERANCE_CELLS * dx
    for collider in colliders:
        if (collider.distance(points) < within).any():
            yield key, f"lies inside the collider '{collider.name}'"
    for name, x in bodies.items():
        if _inside(source, dx, x).any():
            yield key, f"body '{name}' lies in its nozzle, two cells behind its mouth"
    for other in scene.lists["inlet"][:k]:
        if _inside(other, dx, points).any():
            yield key, f"lies in the nozzle of inlet '{other.name}'"
    for sink in outlet_plans(scene):
        if (distance(sink.shape, points) < within).any():
            yield key, f"lies in the outlet '{sink.name}': nothing would come"


def _nozzle(source: Inlet, dx: float) -> np.ndarray:
    """Return points (m, 3) [m] all through a nozzle."""
    h, along = geometry.spacing(source, dx), np.array(source.direction)
    back = (
        np.arange(POINTS_PER_LAYER * geometry.layers_in_nozzle(source) + 1) * h / POINTS_PER_LAYER
    )
    return (geometry.inlet_points(source, dx) - back[:, None, None] * along).reshape(-1, 3)


def _inside(source: Inlet, dx: float, x: np.ndarray) -> np.ndarray:
    """Return which points x (n, 3) [m] lie in the inlet's nozzle, shape (n,); not on its ends."""
    e_u, e_v, along = geometry.orthonormal_frame(source)
    a, b = geometry.extent(source)
    length = geometry.layers_in_nozzle(source) * geometry.spacing(source, dx)
    end = geometry.TOUCH_TOLERANCE_CELLS * dx
    local = x - np.array(source.opening.center)
    u, v, s = ((local * axis).sum(axis=1) for axis in (e_u, e_v, along))
    across = u * u + v * v < a * a if source.disc else (np.abs(u) < a) & (np.abs(v) < b)
    return across & (s < -end) & (s > end - length)
