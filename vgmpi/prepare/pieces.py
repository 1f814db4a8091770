"""One object after the other: read or sampled, placed, filled, coloured, weighed, thinned."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from vgmpi.gaussians import files
from vgmpi.gaussians.checked import LARGEST
from vgmpi.gaussians.cloud import Cloud
from vgmpi.gaussians.evolve import BALLS
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.prepare import cost, fill, mesh, prune, shapes
from vgmpi.prepare.collider import Collider, ShapeCollider, VoxelCollider
from vgmpi.prepare.cost import spacing_of
from vgmpi.prepare.place import (
    Placement,
    PlacementError,
    check_inside,
    corners,
    place,
    turn,
    upright,
)
from vgmpi.prepare.select import selected
from vgmpi.prepare.voxels import (
    COUNTED,
    DISTANCES,
    NEIGHBOURS,
    Voxels,
    share_by_count,
    share_by_neighbours,
    volumes,
)
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

LIGHT = np.array([0.36, -0.48, 0.80])  # unit vector towards the painted light
DARKEST = 1e-3  # least factor of it that is kept, so that colours can be divided by it
_FINENESS = 3  # of the lattice that measures meshes, relative to that of their particles
_BALL = (3 / (4 * np.pi)) ** (1 / 3)  # radius of a ball of volume 1


@dataclass(frozen=True)
class Piece:
    """One object in the domain: its Gaussians, their volumes [m3], and what placed it."""

    cloud: Cloud
    volume: np.ndarray
    placement: Placement
    collider: Collider | None = None
    theta: np.ndarray | None = None  # ln J at the start, where it is not 0
    skin: int = 0  # the first rows, which lie on its surface; the others fill it
    passive: Cloud | None = None  # Gaussians without mass that ride along
    said: str = ""  # how many particles became of it, and what of it weighs
    outline: Callable[[], Collider] | None = None  # what measures distances from its surface
    surface: np.ndarray | None = None  # (n, 10) what contact knows of that (outline.py)


def make(scene: Scene, number: int) -> Piece:
    """Object `number` of the scene in the domain.

    Raises PlacementError, GaussianFileError, MeshError or room.TooLarge where that cannot be done.
    """
    thing = scene.object[number]
    piece = _MAKE[thing.source](scene, number, thing)
    if thing.role == "body":  # fillings and samples too
        check_inside(scene, thing, piece.cloud.x.min(axis=0), piece.cloud.x.max(axis=0), 0.0)
        whole, thinned = piece, ""
        if thing.prune != "off":
            piece, thinned = _pruned(scene, thing, piece)
        if thing.source != "shape":
            said = (
                f"{piece.skin} particles on its surface, {len(piece.cloud) - piece.skin} inside"
                f"{thinned}; {_what_counts(thing, whole)}"
            )
            piece = replace(piece, said=said)
    return piece


def _what_counts(thing: Object, piece: Piece) -> str:
    """What of a body its volume and its mass are, and how much of it cannot be drawn."""
    if thing.source == "mesh":
        return "with its inside"
    if thing.fill is False:
        return "hollow, a skin one voxel thick"
    if len(piece.cloud) == piece.skin:
        return "no inside found, a skin half a voxel thick"
    if thing.fill == "closed":
        return "with its inside where the skin is closed"
    unseen = int((piece.cloud.opacity[piece.skin :] == 0).sum())
    if unseen and thing.opacity > 0:
        return f"with its inside, {unseen} particles of which lie behind holes and are not drawn"
    return "with its inside"


def _from_shape(scene: Scene, k: int, thing: Object) -> Piece:
    shape, spacing = thing.shape, spacing_of(scene, thing)
    at = place(thing, lambda d: shapes.reach(shape, d))
    low, high = corners(at, lambda d: shapes.reach(shape, d))
    if thing.role == "body":
        check_inside(scene, thing, low, high, 1e-6 * spacing)  # before a huge lattice is searched
    more = at.scale * shapes.bulge(shape)
    cost.within_numbers(scene, thing, low - more, high + more)

    def deep(points: np.ndarray) -> np.ndarray:
        return at.scale * shapes.distance(shape, at.own(points))

    skin = 1.01 * spacing if thing.role == "scenery" else np.inf

    def wanted(points: np.ndarray) -> np.ndarray:
        d = deep(points)
        return (d < 0) & (d > -skin)

    def none(middles: np.ndarray) -> np.ndarray:
        d, half = deep(middles), np.sqrt(3.0) / 2 * shapes.BLOCK * spacing
        return (d > half) | (d < -skin - half)

    region = low - more, high + more, spacing
    cubes = shapes.steady(shape) and shapes.worth_cubes(*region)
    cost.looked_at(shapes.span(*region) / (shapes.BLOCK**3 if cubes else 1))
    x = shapes.lattice(wanted, *region, none if cubes else None)
    if not len(x):
        said = f"too small or thin: no particle fits in, their spacing is {spacing:g} m"
        raise PlacementError("shape", said)
    own = at.own(x)
    rgb, shade = shapes.colors(shape, own, thing.colour), None
    if not _is_fluid(scene, thing):
        normal = shapes.normals(shape, own, 0.5 * spacing / at.scale)
        rgb, shade = shaded(rgb, turn(at.rotation, normal), scene.appearance.shade)
    surface = ShapeCollider(thing.name, shape, at, spacing / 2)
    return Piece(
        round_cloud(x, spacing, rgb, thing.opacity, shade), np.full(len(x), spacing**3), at,
        surface if thing.collider else None, outline=lambda: surface,
    )  # fmt: skip


def _from_mesh(scene: Scene, k: int, thing: Object) -> Piece:
    spacing = spacing_of(scene, thing)
    found = mesh.read(scene.files[thing.name])
    at = place(thing, lambda d: float((found.points @ d).max()))
    placed = replace(found, points=at.points(found.points))
    low, high = placed.points.min(axis=0), placed.points.max(axis=0)
    cost.within_numbers(scene, thing, low, high)
    if thing.role == "body":
        check_inside(scene, thing, low, high, 1e-6 * spacing)
    filled = thing.role == "body" or thing.collider

    def search(h: float) -> tuple:
        return (lambda points: mesh.inside(placed, points, h)), low, high, h

    fine = spacing / _FINENESS
    if filled:
        cost.looked_at(shapes.span(low, high, fine))
        places = shapes.span(low, high, spacing)
        cost.afford_inside(scene, k, places, lambda h: len(shapes.lattice(*search(h))))
    surface = mesh.sample(placed, spacing, thing.colour, thing.opacity, [scene.seed, k])
    amount = 0.0 if _is_fluid(scene, thing) else scene.appearance.shade
    rgb, shade = shaded(surface.rgb, mesh.normals(surface), amount)
    surface.sh[:, 0] = dc_from_rgb(rgb)
    surface = replace(surface, shade=shade)
    if not filled:
        return Piece(surface, np.zeros(len(surface)), at)
    inner = shapes.lattice(*search(spacing))
    lack = fill.Lack(inner, np.ones(len(inner), dtype=bool), np.empty((0, 3)))
    return _solid(scene, k, surface, lack, at, shapes.searched(*search(fine)))


def _from_gaussians(scene: Scene, k: int, thing: Object) -> Piece:
    spacing = spacing_of(scene, thing)
    cloud = selected(files.read(scene.files[thing.name]), thing.select)
    if not len(cloud):
        raise PlacementError("select", "selects no Gaussian of the file")
    at = place(thing, lambda d: float((cloud.x @ d).max()))
    cloud = at.cloud(cloud)
    cost.within_numbers(scene, thing, cloud.x.min(axis=0), cloud.x.max(axis=0))
    if not cloud.scale.max() <= LARGEST:
        said = f"makes a Gaussian {cloud.scale.max():.3g} m large; at most {LARGEST:g} m"
        raise PlacementError(cost.sized(thing), said)
    if thing.role == "scenery" and not thing.collider:
        return Piece(cloud, np.zeros(len(cloud)), at)
    if thing.role == "body":
        check_inside(scene, thing, cloud.x.min(axis=0), cloud.x.max(axis=0), 0.0)
    try:
        lack = fill.interior(cloud, spacing, thing.fill, upright(thing, at))
    except fill.TooLarge as error:
        raise PlacementError("fill", str(error)) from None
    return _solid(scene, k, cloud, lack, at)


_MAKE: dict[str, Callable[[Scene, int, Object], Piece]] = {
    "shape": _from_shape,
    "mesh": _from_mesh,
    "gaussians": _from_gaussians,
}


def _solid(
    scene: Scene,
    k: int,
    surface: Cloud,
    lack: fill.Lack,
    at: Placement,
    fine: Iterable[np.ndarray] | None = None,
) -> Piece:
    """A surface and lattice points inside and on it: as a body, or as scenery that others hit.

    fine: points inside of a lattice _FINENESS times as fine, part after part, where the form is
    known exactly. Raises room.TooLarge.
    """
    thing, spacing, gaps = scene.object[k], spacing_of(scene, scene.object[k]), lack.gaps
    shell = np.concatenate([surface.x, gaps])
    voxels = Voxels.around(np.concatenate([shell, lack.inner]), spacing)
    below = ~np.isin(voxels.index(lack.inner), voxels.index(shell))
    inner = lack.inner[below]
    share = None  # every voxel counts in full
    if fine is not None:
        voxels.afford(COUNTED)
        share = share_by_count(voxels, fine, _FINENESS)
    elif thing.fill is not False:
        voxels.afford(NEIGHBOURS)
        share = share_by_neighbours(voxels, shell, inner)
    if thing.role == "scenery":
        voxels.afford(DISTANCES)
        collider = VoxelCollider.of(thing.name, voxels, voxels.solid(share, shell))
        return Piece(surface, np.zeros(len(surface)), at, collider)
    cost.fits(scene, {k: len(shell) + len(inner)}, cost.MADE)
    # what covers the gaps is drawn already, so their particles carry mass only
    unseen = fill.filling(gaps, surface, spacing, 0.0)
    # through a hole a camera would see what fills a body: there it carries mass only as well. What
    # flows or breaks comes to light anyway
    comes = thing.fill == "shown" or scene.material[thing.material].family in BALLS
    drawn = lack.enclosed[below] | comes
    filled = fill.filling(inner, surface, spacing, np.where(drawn, thing.opacity, 0.0))
    cloud = fill.joined(fill.joined(surface, unseen), filled)
    skin = len(surface) + len(gaps)

    def outline() -> VoxelCollider:
        voxels.afford(DISTANCES)
        return VoxelCollider.of(thing.name, voxels, voxels.solid(share, shell)).smoothed()

    return Piece(cloud, volumes(voxels, cloud.x, share), at, skin=skin, outline=outline)


def _pruned(scene: Scene, thing: Object, piece: Piece) -> tuple[Piece, str]:
    """The piece with fewer particles, and words about it."""
    skin = np.arange(len(piece.cloud)) < piece.skin
    ball = scene.material[thing.material].family in BALLS
    if thing.prune == "paper":
        found = prune.paper(piece.cloud, piece.volume, skin, thing.prune_scale, thing.passive, ball)
    else:
        least = max(thing.particles_per_cell, prune.AUTO_PER_CELL)
        dx = scene.domain.cell
        found = prune.auto(piece.cloud, piece.volume, skin, dx, least, thing.passive, ball)
    left = int(skin[found.kept].sum())
    passive = found.dropped if thing.passive else None
    made = replace(piece, cloud=found.cloud, volume=found.volume, skin=left, passive=passive)
    return made, f"; {found.said}"


def round_cloud(
    x: np.ndarray, spacing: float, rgb: np.ndarray, opacity: float, shade: np.ndarray | None = None
) -> Cloud:
    """Round Gaussians at lattice points (n, 3), as large as the ball of a lattice cell's volume.

    rgb (n, 3), shade (n,): as `shaded` gives them.
    """
    n = len(x)
    return Cloud(
        x,
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        np.full((n, 3), _BALL * spacing),
        np.full(n, opacity),
        dc_from_rgb(rgb)[:, None, :].astype(np.float32),
        shade,
    )


def shaded(
    rgb: np.ndarray, normal: np.ndarray, amount: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Colours (n, 3) darkened by up to `amount` where the surface faces away from the light, and
    the factors (n,) of that, at least DARKEST; None where `amount` is 0.

    Gaussians carry no lights: without this a plain body is a flat silhouette. A renderer that has
    lights divides by the factors.
    """
    facing = 0.5 + 0.5 * (normal * LIGHT).sum(axis=1)
    factor = 1.0 - amount * (1.0 - facing)
    kept = np.clip(factor, DARKEST, 1.0).astype(np.float32) if amount else None
    return rgb * factor[:, None], kept


def _is_fluid(scene: Scene, thing: Object) -> bool:
    return thing.role == "body" and scene.material[thing.material].family == "fluid"
