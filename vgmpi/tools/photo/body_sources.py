"""Bodies of the layout's objects from masks, files, hulls or generators, about the eye."""

import io
import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.capture_conventions import log_capture_notes
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.preprocess.placement import axis_rotation

from . import external_generators, gaussian_colors, hollow_body, mask_to_mesh, preview, visual_hull
from .background_inpainting import inpaint_background
from .external_generators import GeneratorError
from .grabcut import box_of
from .layout_config import LayoutError, LoadedLayout, ObjectTable
from .mask_to_mesh import BodyError, Reconstruction
from .object_masks import ObjectMask, share_pixels
from .object_placement import UnplacedObject
from .photo_camera import View
from .photograph import Photograph
from .visual_hull import HullError

log = logging.getLogger("vgmpi.tools.photo")

Guess = tuple[tuple, Any, str]
GLTF = (".glb", ".gltf")  # more often meshes than Gaussians: taken if there is no other file
MIN_IOU = 0.7  # [-] bodies below this intersection over union hardly fit their masks


class Scenery(NamedTuple):
    """Common input of all bodies."""

    loaded: LoadedLayout
    photo: Photograph
    view: View
    out: Path  # folder of the scene
    cups: dict[str, hollow_body.Cup]  # cups that are fitted already, by their names (in/out)


def make_bodies(
    scenery: Scenery, masks: list[ObjectMask], guesses: list[Guess]
) -> list[UnplacedObject]:
    """Make the bodies of all objects and append the guesses.

    Raises:
        LayoutError: A body cannot be made.
        OSError: A file cannot be read or written.
    """
    return [
        UnplacedObject(obj, _body(k, obj, scenery, [item.mask for item in masks], guesses))
        for k, obj in enumerate(scenery.loaded.layout.object)
    ]


def _body(
    k: int, obj: ObjectTable, scenery: Scenery, masks: list[np.ndarray], guesses: list[Guess]
) -> GaussianCloud:
    """Return the Gaussians of one object about the eye.

    Args:
        k: Index of the object.
        obj: Table of the object.
        scenery: Common input.
        masks: All objects, each (height, width) bool.
        guesses: Guesses, to which the found pose is appended (in/out).
    """
    config, mask = scenery.loaded.layout.bodies, masks[k]
    key = "body"
    up: str | None = obj.up
    try:
        file = _body_file(obj, scenery.loaded)
        if file is None and config.folder and obj.reconstruction is None and obj.multi_view is None:
            log.info("'%s': no file of its name in %s", obj.name, config.folder)
        if file is not None:
            cloud = _read_body(file)
            log.info("'%s': the body in %s, %d Gaussians", obj.name, file, len(cloud))
        elif obj.multi_view is not None:
            key, up = "multi_view", up or "z"
            cloud = visual_hull.body(
                visual_hull.read(scenery.loaded.path(obj.multi_view)), k + 1, up
            )
            log.info("'%s': the hull of %s, %d Gaussians", obj.name, obj.multi_view, len(cloud))
        elif obj.reconstruction is None and obj.inside is None and config.method != "mask":
            cloud = _body_from_generator(obj, scenery, mask)
            up = up or external_generators.KINDS[config.method].up
        else:
            key = "reconstruction" if obj.inside is None else "inside"
            return _body_from_mask(k, obj, scenery, masks, guesses)
    except (BodyError, HullError, GaussianFileError, MeshError) as error:
        raise scenery.loaded.wrong((("object", k, key), str(error))) from None
    except GeneratorError as error:
        path = ("bodies", error.key) if error.key else ("object", k)
        raise scenery.loaded.wrong((path, str(error))) from None
    aligned = external_generators.align_to_photo(
        cloud, scenery.photo.rgb, mask, scenery.view, up, obj.yaw
    )
    pose = aligned.pose
    agreement = f"outline agrees to {pose.iou:.2f}, colors differ by {pose.color_error:.2f}"
    log.info("'%s': up %s, yaw %g degrees: %s", obj.name, pose.up, pose.yaw, agreement)
    if pose.iou < MIN_IOU:
        log.warning("'%s': hardly fits its mask (%.2f): another body?", obj.name, pose.iou)
    if obj.up is None:
        guesses.append((("object", k, "up"), pose.up, f"axis of its file, found: {agreement}"))
    if obj.yaw is None:
        guesses.append((("object", k, "yaw"), pose.yaw, f"degrees, found: {agreement}"))
    return aligned.cloud


def is_from_mask(obj: ObjectTable, loaded: LoadedLayout) -> bool:
    """Return whether a body comes from its mask alone and stands as the photograph shows it."""
    if obj.multi_view is not None or obj.yaw or _body_file(obj, loaded) is not None:
        return False
    by_default = obj.reconstruction is None and obj.inside is None
    return not by_default or loaded.layout.bodies.method == "mask"


def _body_from_mask(
    k: int, obj: ObjectTable, scenery: Scenery, masks: list[np.ndarray], guesses: list[Guess]
) -> GaussianCloud:
    """Make a body from the mask alone, or a liquid from its mask and that of its cup.

    Raises:
        BodyError: The mask gives no body.
    """
    method: Reconstruction = obj.reconstruction or "inflate"
    thickness = obj.thickness
    if obj.reconstruction is None and obj.inside is None:
        guesses.append((("object", k, "reconstruction"), method, "guessed: the usual one"))
    if thickness is None:
        thickness = mask_to_mesh.THICKNESS
        if method == "extrude":
            guesses.append((("object", k, "thickness"), thickness, "of its width, guessed"))
    if obj.inside is not None:
        surface = _liquid(obj, scenery, masks[k], masks)
    elif method == "cup":
        surface = _cup(k, scenery, masks)
    else:
        surface = mask_to_mesh.body(masks[k], scenery.view, method, thickness)
    rgb = _without_front(k, scenery, masks)
    mask = masks[k] if obj.inside is None else gaussian_colors.liquid_interior(masks[k])
    cloud = gaussian_colors.gaussians(surface, rgb, mask, scenery.view, seed=k + 1)
    kind = method if obj.inside is None else "liquid"
    log.info("'%s': %s, %d Gaussians", obj.name, kind, len(cloud))
    if obj.yaw:
        rotation = axis_rotation((0.0, 0.0, 1.0), np.radians(obj.yaw))
        middle = (cloud.x.min(axis=0) + cloud.x.max(axis=0)) / 2
        cloud = cloud.transformed(rotation, 1.0, middle - rotation @ middle)
    return cloud


def _fitted_cup(number: int, scenery: Scenery, masks: list[np.ndarray]) -> hollow_body.Cup:
    """Return the hollow body of an object, which is fitted for the first who asks for it.

    Raises:
        BodyError: No upright body of revolution is seen as its mask.
    """
    obj = scenery.loaded.layout.object[number]
    if obj.name not in scenery.cups:
        wall = hollow_body.WALL if obj.wall is None else obj.wall
        scenery.cups[obj.name] = hollow_body.cup(masks[number], scenery.view, wall)
    return scenery.cups[obj.name]


def _cup(number: int, scenery: Scenery, masks: list[np.ndarray]) -> Mesh:
    """Return the surface of a cup and of its handles; raise a BodyError if there are none."""
    hollow = _fitted_cup(number, scenery, masks)
    parts = hollow_body.handles(hollow, masks[number], scenery.view)
    for _, pixels in parts:
        name = scenery.loaded.layout.object[number].name
        log.info("'%s': a part beside the hollow body, %d pixels", name, pixels)
    return hollow_body.join_surfaces(
        [hollow_body.cup_surface(hollow), *(surface for surface, _ in parts)]
    )


def _liquid(obj: ObjectTable, scenery: Scenery, mask: np.ndarray, masks: list) -> Mesh:
    """Return the surface of a liquid in its cup; raise a BodyError if no level is seen so."""
    number = [item.name for item in scenery.loaded.layout.object].index(str(obj.inside))
    hollow = _fitted_cup(number, scenery, masks)
    level, agreement = hollow_body.liquid_level(hollow, mask, scenery.view)
    bottom, top = hollow.cavity.heights[[0, -1]]
    filling = 100 * (level - bottom) / (top - bottom)
    log.info("'%s': fills %.0f %% of the depth of '%s', its surface agrees to %.2f",
             obj.name, filling, obj.inside, agreement)  # fmt: skip
    return hollow_body.liquid_surface(hollow, level)


def _without_front(k: int, scenery: Scenery, masks: list[np.ndarray]) -> np.ndarray:
    """Return the photograph without what hides a part of an object, whose colors it lacks.

    That are objects that share much of its mask and stand on it or are smaller. A liquid inside it
    wets it: what the liquid leaves bare has its color.
    """
    objects, mask, rgb = scenery.loaded.layout.object, masks[k], scenery.photo.rgb
    name = objects[k].name
    front = [
        other for item, other in zip(objects, masks)
        if item.inside is None and share_pixels(mask, other)
        and (item.support == name or other.sum() < mask.sum())
    ]  # fmt: skip
    covered = np.logical_or.reduce([np.zeros_like(mask), *front])
    if not (covered & mask).any() or not (mask & ~covered).any():
        return rgb
    left, top, right, bottom = box_of(mask)
    cut = slice(top, bottom), slice(left, right)
    filled = inpaint_background(rgb[cut], [(covered | ~mask)[cut]])
    result = rgb.copy()
    result[cut] = np.where((covered & mask)[cut][..., None], filled, rgb[cut])
    return result


def _body_file(obj: ObjectTable, loaded: LoadedLayout) -> Path | None:
    """Return the file with an object's body, None if there is none."""
    if obj.body is not None:
        return loaded.path(obj.body)
    config = loaded.layout.bodies
    if not config.folder or obj.reconstruction is not None or obj.multi_view is not None:
        return None
    folder = loaded.path(config.folder)
    if not folder.is_dir():
        raise LayoutError(loaded.source.lines([(("bodies", "folder"), f"no folder {folder}")]))
    names = [suffix for suffix in registry.KINDS if suffix not in GLTF]
    for suffix in (*names, *surface_mesh.FORMATS, *GLTF):
        if (folder / f"{obj.name}{suffix}").is_file():
            return folder / f"{obj.name}{suffix}"
    return None


def _read_body(file: Path) -> GaussianCloud:
    """Read Gaussians, or a mesh as Gaussians.

    Raises:
        GaussianFileError: The Gaussians are unreadable.
        MeshError: The mesh is unreadable or of an unknown kind.
    """
    suffix = file.suffix.lower()
    if suffix not in (*registry.KINDS, *surface_mesh.FORMATS):
        valid = ", ".join(dict.fromkeys((*registry.KINDS, *surface_mesh.FORMATS)))
        raise MeshError(f"{file}: allowed: a name that ends in {valid}")
    try:
        if suffix in registry.KINDS:
            cloud = registry.read(file)
            log_capture_notes(file, cloud)
            return cloud
    except GaussianFileError as error:
        if suffix != ".ply" or "mesh" not in str(error) and "not a cloud" not in str(error):
            raise
    if not file.is_file():
        raise MeshError(f"{file}: no such file")
    surface = surface_mesh.read(file)
    extent = float(np.ptp(surface.points[surface.triangles.ravel()], axis=0).max())
    return surface_mesh.sample(surface, extent / 100, (0.7, 0.7, 0.7), gaussian_colors.OPACITY, [1])


def _body_from_generator(obj: ObjectTable, scenery: Scenery, mask: np.ndarray) -> GaussianCloud:
    """Let a generator make a body of the object's crop.

    Raises:
        GeneratorError: The generator fails.
        OSError: A file cannot be read or written.
    """
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(preview.crop(scenery.photo.rgb, mask)).save(buffer, "png")
    layout_folder = scenery.loaded.source.folder
    return external_generators.make(
        obj.name, buffer.getvalue(), scenery.loaded.layout.bodies, layout_folder, scenery.out
    )
