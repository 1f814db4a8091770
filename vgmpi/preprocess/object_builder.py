"""Builder of one object: reads or samples it, places, fills, colors, weighs and prunes it."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from vgmpi.gaussians import shape_distance
from vgmpi.gaussians.baked_shading import apply_baked_shading
from vgmpi.gaussians.capture_conventions import log_capture_notes, with_render_model
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import MAX_MAGNITUDE
from vgmpi.gaussians.shape_evolution import FAMILIES_DRAWN_AS_SPHERES
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.preprocess.meshes import point_in_mesh, surface_mesh
from vgmpi.preprocess.pruning import prune
from vgmpi.preprocess.sampling import interior_fill
from vgmpi.preprocess.sampling.voxels import (
    BYTES_COUNTED,
    BYTES_DISTANCES,
    BYTES_NEIGHBORS,
    Voxels,
    fraction_by_neighbours,
    fraction_by_supersampling,
    volumes,
)
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

from . import memory_estimate, shape_sdf
from .built_object import BuiltObject, isotropic_gaussians
from .capture_selection import capture_floaters, crop
from .collider_sdf import ShapeCollider, VoxelCollider
from .memory_estimate import spacing_of
from .placement import (
    PlacementError,
    SimilarityTransform,
    check_inside,
    corners,
    placement,
    rotate,
    upright,
)
from .point_files import PointFileError, read_points
from .sheet_collider import SheetCollider, examine_mesh

log = logging.getLogger("vgmpi")

_FINENESS = (
    3  # [-] resolution of the lattice that measures meshes, relative to their particles' lattice
)


def build_object(scene: Scene, number: int) -> BuiltObject:
    """Return object `number` of the scene in the domain.

    Raises:
        PlacementError, GaussianFileError, MeshError, InsufficientMemoryError: The object cannot be
        made.
    """
    obj = scene.object[number]
    piece = _MAKE[obj.source](scene, number, obj)
    if obj.role == "body":  # this includes fillings and samples
        check_inside(scene, obj, piece.cloud.x.min(axis=0), piece.cloud.x.max(axis=0))
        complete, pruning = piece, ""
        if obj.prune != "off":
            piece, pruning = _pruned(scene, obj, piece)
        if obj.source not in ("shape", "points"):
            summary = (
                f"{piece.surface_count} particles on its surface,"
                f" {len(piece.cloud) - piece.surface_count} inside{pruning};"
                f" {_volume_convention(obj, complete)}"
            )
            piece = replace(piece, summary=summary)
    return piece


def _volume_convention(obj: Object, piece: BuiltObject) -> str:
    """Return text on the volume that counts as the body, and on particles that are not drawn."""
    if obj.source == "mesh":
        return "with its inside"
    if obj.fill is False:
        return "hollow, a skin one voxel thick"
    if len(piece.cloud) == piece.surface_count:
        return "no inside found, a skin half a voxel thick"
    if obj.fill == "closed":
        return "with its inside where the skin is closed"
    hidden = int((piece.cloud.opacity[piece.surface_count :] == 0).sum())
    if hidden and obj.opacity > 0:
        return f"with its inside, {hidden} particles of which lie behind holes and are not drawn"
    return "with its inside"


def _from_shape(scene: Scene, k: int, obj: Object) -> BuiltObject:
    """Return an object made of a shape."""
    shape, spacing = obj.shape, spacing_of(scene, obj)
    assert shape is not None
    transform = placement(obj, lambda d: shape_sdf.support(shape, d))
    low, high = corners(transform, lambda d: shape_sdf.support(shape, d))
    if obj.role == "body":
        check_inside(scene, obj, low, high)  # before a huge lattice is searched
    overhang = transform.scale * shape_sdf.blend_overhang(shape)
    memory_estimate.within_numbers(scene, obj, low - overhang, high + overhang)

    def signed_distance(points: np.ndarray) -> np.ndarray:
        """Return the signed distance [m] of points."""
        return transform.scale * shape_distance.distance(shape, transform.to_local(points))

    layer_count = memory_estimate.SCENERY_LAYER_COUNT + 0.01  # a surface may lie at a lattice point
    skin = layer_count * spacing if obj.role == "scenery" else np.inf

    def is_wanted(points: np.ndarray) -> np.ndarray:
        """Return which points become particles."""
        d = signed_distance(points)
        return (d < 0) & (d > -skin)

    def is_empty(centers: np.ndarray) -> np.ndarray:
        """Return which cubes hold no particle, by their centers."""
        d, half = signed_distance(centers), np.sqrt(3.0) / 2 * shape_sdf.BLOCK * spacing
        return (d > half) | (d < -skin - half)

    region = low - overhang, high + overhang, spacing
    cubes = shape_sdf.is_lipschitz(shape) and shape_sdf.prefer_block_search(*region)
    memory_estimate.require_search_size(
        shape_sdf.lattice_size(*region) / (shape_sdf.BLOCK**3 if cubes else 1)
    )
    x = shape_sdf.lattice(is_wanted, *region, is_empty if cubes else None)
    if not len(x):
        message = f"too small or thin: no particle fits in, their spacing is {spacing:g} m"
        raise PlacementError("shape", message)
    local = transform.to_local(x)
    rgb, shade = shape_sdf.colors(shape, local, obj.color), None
    if not _is_fluid(scene, obj):
        normal = shape_distance.normals(shape, local, 0.5 * spacing / transform.scale)
        rgb, shade = apply_baked_shading(
            rgb, rotate(transform.rotation, normal), scene.appearance.baked_shading
        )
    surface = ShapeCollider(obj.name, shape, transform, spacing / 2)
    return BuiltObject(
        isotropic_gaussians(x, spacing, rgb, obj.opacity, shade), np.full(len(x), spacing**3),
        transform, surface if obj.collider else None, surface_sdf=lambda: surface,
    )  # fmt: skip


def _from_mesh(scene: Scene, k: int, obj: Object) -> BuiltObject:
    """Return an object made of a surface mesh."""
    spacing = spacing_of(scene, obj)
    whole_mesh = surface_mesh.read(scene.files[obj.name])
    if whole_mesh.has_material_colors and "color" in obj.model_fields_set:
        whole_mesh = replace(whole_mesh, triangle_rgb=None)
    transform = placement(obj, lambda d: float((whole_mesh.points @ d).max()))
    placed = replace(whole_mesh, points=transform.to_domain(whole_mesh.points))
    low, high = placed.points.min(axis=0), placed.points.max(axis=0)
    memory_estimate.within_numbers(scene, obj, low, high)
    if obj.role == "body":
        check_inside(scene, obj, low, high)
    filled = obj.role == "body" or obj.collider
    is_sheet = False
    if filled:
        placed, is_sheet = examine_mesh(obj, placed)

    def search(h: float) -> tuple:
        """Return the arguments of a lattice search at spacing h [m]."""
        return (lambda points: point_in_mesh.inside(placed, points, h)), low, high, h

    fine = spacing / _FINENESS
    if filled and not is_sheet:
        memory_estimate.require_search_size(shape_sdf.lattice_size(low, high, fine))
        candidates = shape_sdf.lattice_size(low, high, spacing)
        memory_estimate.require_memory_for_interior(
            scene, k, candidates, lambda h: len(shape_sdf.lattice(*search(h)))
        )
    surface = surface_mesh.sample(placed, spacing, obj.color, obj.opacity, [scene.seed, k])
    amount = 0.0 if _is_fluid(scene, obj) else scene.appearance.baked_shading
    rgb, shade = apply_baked_shading(surface.rgb, surface_mesh.normals(surface), amount)
    surface.sh[:, 0] = dc_from_rgb(rgb)
    surface = replace(surface, shade=shade)
    if not filled:
        return BuiltObject(surface, np.zeros(len(surface)), transform)
    if is_sheet:
        walls = SheetCollider.from_triangles(obj.name, placed.corners(), scene.domain.cell)
        return BuiltObject(surface, np.zeros(len(surface)), transform, walls)
    inner = shape_sdf.lattice(*search(spacing))
    missing = interior_fill.MissingInterior(
        inner, np.ones(len(inner), dtype=bool), np.empty((0, 3))
    )
    return _solid(scene, k, surface, missing, transform, shape_sdf.lattice_chunks(*search(fine)))


def _from_gaussians(scene: Scene, k: int, obj: Object) -> BuiltObject:
    """Return an object made of a Gaussian file."""
    spacing = spacing_of(scene, obj)
    cloud = registry.read(scene.files[obj.name], obj.frame)
    log_capture_notes(f"'{obj.name}'", cloud)
    cloud = crop(cloud, obj.select)
    if obj.render_model is not None:
        cloud = with_render_model(cloud, obj.render_model)
    if not len(cloud):
        raise PlacementError("select", "selects no Gaussian of the file")
    floaters = capture_floaters(obj, cloud)
    drawn, cloud = cloud, cloud if floaters is None else cloud.select(~floaters.mask)
    transform = placement(obj, lambda d: float((cloud.x @ d).max()))
    cloud = transform.cloud(cloud)
    memory_estimate.within_numbers(scene, obj, cloud.x.min(axis=0), cloud.x.max(axis=0))
    if not cloud.scale.max() <= MAX_MAGNITUDE:
        message = f"makes a Gaussian {cloud.scale.max():.3g} m large; at most {MAX_MAGNITUDE:g} m"
        raise PlacementError(memory_estimate.sized(obj), message)
    if obj.role == "scenery":  # floaters may be its background
        drawn = transform.cloud(drawn)
        if not obj.collider:
            return BuiltObject(drawn, np.zeros(len(drawn)), transform)
    else:
        check_inside(scene, obj, cloud.x.min(axis=0), cloud.x.max(axis=0))
    try:
        missing = interior_fill.interior(cloud, spacing, obj.fill, upright(obj, transform))
    except interior_fill.VoxelGridTooLargeError as error:
        raise PlacementError("fill", str(error)) from None
    if obj.role == "body":  # wide Gaussians next to a wall reach through it, and their voxels, too
        missing = missing.inside_box(np.asarray(scene.domain.size))
        return _solid(scene, k, cloud, missing, transform)
    piece = _solid(scene, k, cloud, missing, transform)
    return replace(piece, cloud=drawn, volume=np.zeros(len(drawn)))


def _from_points(scene: Scene, k: int, obj: Object) -> BuiltObject:
    """Return a body of the particles that a file or a program gives."""
    spacing, points = spacing_of(scene, obj), obj.points
    assert points is not None
    if points.file is not None:
        try:
            points = read_points(scene.files[obj.name], points.spacing)
        except PointFileError as error:
            raise PlacementError("points", str(error)) from None
    assert points.positions is not None
    transform = placement(obj, lambda d: float((points.positions @ d).max()))
    x = transform.to_domain(points.positions)
    low, high = x.min(axis=0), x.max(axis=0)
    memory_estimate.within_numbers(scene, obj, low, high)
    check_inside(scene, obj, low, high)
    voxels = Voxels.enclosing(x, spacing)
    if points.volumes is not None:
        volume = transform.scale**3 * points.volumes
    elif points.spacing is not None:
        volume = np.full(len(x), (transform.scale * points.spacing) ** 3)
    else:
        volume = volumes(voxels, x, None)
    edge = np.cbrt(volume)
    if not edge.max() <= scene.domain.cell:
        message = f"a particle as large as a cube of {edge.max():.3g} m is larger than a cell of"
        raise PlacementError("points", f"{message} {scene.domain.cell:g} m: it would leave gaps")

    def outline() -> VoxelCollider:
        """Return the signed distance of the surface."""
        voxels.afford(BYTES_DISTANCES)
        return VoxelCollider.from_voxels(obj.name, voxels, voxels.solid(None, x)).smoothed()

    rgb = np.tile(obj.color, (len(x), 1)) if points.colors is None else points.colors
    cloud = isotropic_gaussians(x, edge, rgb, obj.opacity)
    if points.velocities is not None and scene.is_moved(k):
        message = "has velocities, which are not for a body with motion or release_time"
        raise PlacementError("points", message)
    v = None if points.velocities is None else rotate(transform.rotation, points.velocities)
    return BuiltObject(cloud, volume, transform, surface_sdf=outline, velocity=v)


_MAKE: dict[str, Callable[[Scene, int, Object], BuiltObject]] = {
    "shape": _from_shape,
    "mesh": _from_mesh,
    "gaussians": _from_gaussians,
    "points": _from_points,
}


def _solid(
    scene: Scene, k: int, surface: GaussianCloud, missing: interior_fill.MissingInterior,
    transform: SimilarityTransform, fine: Iterable[np.ndarray] | None = None,
) -> BuiltObject:  # fmt: skip
    """Return a body, or scenery that collides, from a surface and lattice points inside and on it.

    Args:
        scene: The scene.
        k: Row of the object.
        surface: Gaussians of the surface.
        missing: Lattice points inside and on the surface.
        transform: Placement of the object.
        fine: Points inside of a lattice _FINENESS times as fine, in chunks, if the form is exact.

    Raises InsufficientMemoryError.
    """
    obj, spacing, gaps = scene.object[k], spacing_of(scene, scene.object[k]), missing.gap_points
    shell = np.concatenate([surface.x, gaps])
    voxels = Voxels.enclosing(np.concatenate([shell, missing.interior_points]), spacing)
    below = ~np.isin(voxels.index(missing.interior_points), voxels.index(shell))
    inner = missing.interior_points[below]
    fraction = None  # None: every voxel counts in full
    if fine is not None:
        voxels.afford(BYTES_COUNTED)
        fraction = fraction_by_supersampling(voxels, fine, _FINENESS)
    elif obj.fill is not False:
        voxels.afford(BYTES_NEIGHBORS)
        fraction = fraction_by_neighbours(voxels, shell, inner)
    if obj.role == "scenery":
        voxels.afford(BYTES_DISTANCES)
        collider = VoxelCollider.from_voxels(obj.name, voxels, voxels.solid(fraction, shell))
        return BuiltObject(surface, np.zeros(len(surface)), transform, collider)
    memory_estimate.require_particle_memory(
        scene, {k: len(shell) + len(inner)}, memory_estimate.BYTES_PER_PARTICLE
    )
    # The gaps are drawn already by Gaussians that cover them, so these particles carry mass only.
    unseen = interior_fill.filling(gaps, surface, spacing, 0.0)
    # Through a hole a camera would see the filling of a body: there it carries mass only as well.
    # The inside of bodies that flow or break becomes visible anyway.
    shows = obj.fill == "visible" or scene.material_of(obj).family in FAMILIES_DRAWN_AS_SPHERES
    drawn = missing.enclosed[below] | shows
    filled = interior_fill.filling(inner, surface, spacing, np.where(drawn, obj.opacity, 0.0))
    cloud = interior_fill.joined(interior_fill.joined(surface, unseen), filled)
    skin = len(surface) + len(gaps)

    def outline() -> VoxelCollider:
        """Return the signed distance of the surface."""
        voxels.afford(BYTES_DISTANCES)
        return VoxelCollider.from_voxels(obj.name, voxels, voxels.solid(fraction, shell)).smoothed()

    return BuiltObject(
        cloud,
        volumes(voxels, cloud.x, fraction),
        transform,
        surface_count=skin,
        surface_sdf=outline,
    )


def _pruned(scene: Scene, obj: Object, piece: BuiltObject) -> tuple[BuiltObject, str]:
    """Return the object with fewer particles, and text about it."""
    skin = np.arange(len(piece.cloud)) < piece.surface_count
    ball = scene.material_of(obj).family in FAMILIES_DRAWN_AS_SPHERES
    if obj.prune == "versagauss":
        assert obj.prune_scale is not None  # the scene is refused without
        pruned = prune.prune_versagauss(
            piece.cloud, piece.volume, skin, obj.prune_scale, obj.passive_gaussians, ball
        )
    else:
        min_per_cell = max(obj.particles_per_cell, prune.AUTO_PER_CELL)
        dx = scene.domain.cell
        pruned = prune.prune_to_quality(
            piece.cloud, piece.volume, skin, dx, min_per_cell, obj.passive_gaussians, ball
        )
    surface_count = int(skin[pruned.retained].sum())
    passive = pruned.dropped if obj.passive_gaussians else None
    thinner = replace(
        piece,
        cloud=pruned.cloud,
        volume=pruned.volume,
        surface_count=surface_count,
        passive=passive,
    )
    return thinner, f"; {pruned.summary}"


def _is_fluid(scene: Scene, obj: Object) -> bool:
    """Return whether an object is a body of a fluid."""
    return obj.role == "body" and scene.material_of(obj).family == "fluid"
