"""Lower bounds of the memory that a scene's objects need, estimated before they are made.

Since all numbers are lower bounds, nothing that would fit is refused: objects are counted by their
boxes first, and by random points in them if their boxes do not fit.
"""

from collections.abc import Callable

import numpy as np

from vgmpi.gaussians import shape_distance
from vgmpi.runtime import process_limits
from vgmpi.scene.objects import SIZES, Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

from . import shape_sdf
from .placement import (
    PlacementError,
    SimilarityTransform,
    check_inside,
    corners,
    placement,
    placement_key,
)

# [bytes] of a particle with a plain color: while its object is made, and when all are joined
BYTES_PER_PARTICLE = {"body": 108, "scenery": 100}
BYTES_PER_PARTICLE_MERGED = {"body": 108, "scenery": 68}
BYTES_PER_CANDIDATE = 24  # [bytes] of a lattice point
SCENERY_LAYER_COUNT = 2  # [-] layers of Gaussians below a surface of scenery; one has gaps in it
MAX_PLACES = 2.0**38  # [points] searched for particles; more would take days
MAX_DISTANCE_SPACINGS = (
    2.0**52
)  # [spacings] distance of a particle from the origin; double precision is no finer there
_SAMPLE_COUNT = 1 << 16  # [points] random points in a box
_CONFIDENCE_SIGMAS = 4.0  # [-] standard deviations by which a count is lowered
_MAX_LAYER_DEPTH = (
    0.02  # [-] of the box's size: largest thickness of a tested layer below a surface
)


def require_memory_for_shapes(scene: Scene) -> None:
    """Raise SceneError, one line, if particles of shapes cannot fit into the memory."""
    upper_counts, available = {}, process_limits.available_memory(swap=True)
    for k, obj in enumerate(scene.object):
        if (region := _box(scene, obj)) is not None:
            upper_counts[k] = shape_sdf.lattice_size(*region[1:], spacing_of(scene, obj))
    bytes_of = {
        role: BYTES_PER_PARTICLE[role] + BYTES_PER_PARTICLE_MERGED[role]
        for role in BYTES_PER_PARTICLE
    }
    needed = {k: n * bytes_of[scene.object[k].role] for k, n in upper_counts.items()}
    if not available or sum(needed.values()) <= available:
        return
    # Small objects are left out, since each takes a moment to sample.
    large = [k for k in upper_counts if needed[k] > 1e-3 * available]
    require_particle_memory(
        scene, {k: min_particle_count(scene, scene.object[k]) for k in large}, bytes_of
    )


def require_memory_for_interior(
    scene: Scene, k: int, candidates: float, count: Callable[[float], int]
) -> None:
    """Raise SceneError, one line, if the interior of object k cannot fit into the memory.

    Args:
        scene: The scene.
        k: Row of the object.
        candidates: Number of lattice points in its box.
        count: Returns how many points of a lattice of a given spacing [m] are inside; a coarse
            lattice is tried if the box does not fit.
    """
    bytes_of = {
        "body": BYTES_PER_PARTICLE["body"] + BYTES_PER_PARTICLE_MERGED["body"],
        "scenery": BYTES_PER_CANDIDATE,
    }
    available = process_limits.available_memory(swap=True)
    if available and candidates * bytes_of[scene.object[k].role] > available:
        coarser = (candidates / _SAMPLE_COUNT) ** (1 / 3)
        inside_count = count(coarser * spacing_of(scene, scene.object[k]))
        lower_count = max(0.0, inside_count - _CONFIDENCE_SIGMAS * np.sqrt(inside_count))
        require_particle_memory(scene, {k: lower_count * coarser**3}, bytes_of)


def require_particle_memory(
    scene: Scene, count: dict[int, float], bytes_of: dict[str, int]
) -> None:
    """Raise SceneError, one line with the key that drives it, if particles do not fit.

    Args:
        scene: The scene.
        count: Particles of objects by their rows.
        bytes_of: Bytes per particle, by the object's role.
    """
    needed = {k: n * bytes_of[scene.object[k].role] for k, n in count.items()}
    if not needed:
        return
    k = max(needed, key=lambda k: needed[k])
    obj, unit = scene.object[k], "particles" if scene.object[k].role == "body" else "Gaussians"
    message = f"makes at least {count[k]:.3g} {unit} of '{obj.name}'"
    message = f"{scene.domain.cell:g} m {message}" if unit == "particles" else message
    others = sum(count.values()) - count[k]
    total = f", with all others {others + count[k]:.3g}" if others else ""
    try:
        process_limits.require_memory(sum(needed.values()),
        f"{message}, {spacing_of(scene, obj):g} m apart{total}: at"
                   " least")  # fmt: skip
    except process_limits.InsufficientMemoryError as error:
        raise scene.error([(key(scene, k), str(error))]) from None


def key(scene: Scene, k: int) -> tuple:
    """Return the key of the scene that drives the cost of object k.

    Bodies lie in the domain, so that it is their cells; scenery may be of any size.
    """
    obj = scene.object[k]
    if obj.role == "body":
        return ("domain", "cell")
    return ("object", k, sized(obj))


def sized(obj: Object) -> str:
    """Return the key that gives the size of an object."""
    return next(name for name in (*SIZES, obj.source) if getattr(obj, name) is not None)


def within_numbers(scene: Scene, obj: Object, low: np.ndarray, high: np.ndarray) -> None:
    """Raise PlacementError if an object is too large, too far away, or too small for doubles.

    Args:
        scene: The scene.
        obj: The object.
        low: Its lower corner, shape (3,) [m].
        high: Its upper corner, shape (3,) [m].
    """
    limit = MAX_DISTANCE_SPACINGS * spacing_of(scene, obj)
    if not (np.abs([low, high]) <= limit).all():  # this includes NaN
        message = (
            f"reaches {np.abs([low, high]).max():.3g} m from the origin; at most {limit:.3g} m"
        )
        raise PlacementError(placement_key(obj), f"{message} are possible with cells of"
                             f" {scene.domain.cell:g} m")  # fmt: skip
    length, size = float((high - low).max()), scene.domain.size
    for feature in features():
        for (key,), message in feature.check_size(obj, length, size):
            raise PlacementError(key, message)


def require_search_size(candidates: float) -> None:
    """Raise InsufficientMemoryError if too many lattice points would be searched for particles."""
    if not candidates <= MAX_PLACES:
        message = f"{candidates:.3g} places for particles would have to be looked at"
        raise process_limits.InsufficientMemoryError(f"{message}; at most {MAX_PLACES:.3g} are")


def spacing_of(scene: Scene, obj: Object) -> float:
    """Return the lattice spacing [m] of an object's particles."""
    return scene.domain.cell / round(obj.particles_per_cell ** (1 / 3))


def min_particle_count(scene: Scene, obj: Object) -> float:
    """Return a lower bound of the number of particles of a shape.

    Random points in its box give the fraction inside or, for scenery, which is a skin, close below
    the surface: the best of layers of several thicknesses, since points may miss a thin layer and a
    thick one reaches through the body.
    """
    region, shape = _box(scene, obj), obj.shape
    assert region is not None and shape is not None
    transform, low, high = region
    draw = np.random.Generator(np.random.Philox(1)).random((_SAMPLE_COUNT, 3))
    depth = -transform.scale * shape_distance.distance(
        shape, transform.to_local(low + draw * (high - low))
    )
    spacing, volume = spacing_of(scene, obj), float(np.prod(high - low))
    layers = [float(SCENERY_LAYER_COUNT)]  # [spacings]
    while obj.role == "scenery" and layers[-1] * spacing < _MAX_LAYER_DEPTH * volume ** (1 / 3):
        layers.append(2.0 * layers[-1])
    counts = []
    for layer in layers:
        max_depth = layer * spacing if obj.role == "scenery" else np.inf
        hits = np.count_nonzero((depth > 0) & (depth < max_depth))
        fraction = max(0.0, hits - _CONFIDENCE_SIGMAS * np.sqrt(hits)) / _SAMPLE_COUNT
        skin_part = SCENERY_LAYER_COUNT / layer if obj.role == "scenery" else 1.0
        counts.append(fraction * volume / spacing**3 * skin_part)
    return max(counts)


def approximate_particle_count(scene: Scene, obj: Object, exact_from: int = 1_000) -> float:
    """Return about how many particles a shape will have; 0 if its place is not valid.

    Args:
        scene: The scene.
        obj: An object with a shape.
        exact_from: Lattice points in its box from which on the shape itself is sampled.
    """
    region = _box(scene, obj)
    if region is None:
        return 0.0
    points = shape_sdf.lattice_size(*region[1:], spacing_of(scene, obj))
    return min_particle_count(scene, obj) if points >= exact_from else float(points)


def _box(scene: Scene, obj: Object) -> tuple[SimilarityTransform, np.ndarray, np.ndarray] | None:
    """Return placement and corners (3,) [m] of a shape; None without one or if invalid."""
    shape = obj.shape
    if shape is None:
        return None
    try:
        transform = placement(obj, lambda d: shape_sdf.support(shape, d))
        low, high = corners(transform, lambda d: shape_sdf.support(shape, d))
        if obj.role == "body":
            check_inside(scene, obj, low, high)
    except PlacementError:
        return None
    overhang = transform.scale * shape_sdf.blend_overhang(shape)
    return transform, low - overhang, high + overhang
