"""Bodies of the layout's objects from masks, files, hulls or generators, about the eye."""

import io
import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.preprocess.placement import axis_rotation

from . import external_generators, gaussian_colors, mask_to_mesh, pose_search, preview, visual_hull
from .external_generators import GeneratorError
from .layout_config import LayoutError, LoadedLayout, ObjectTable
from .mask_to_mesh import BodyError
from .object_masks import ObjectMask
from .object_placement import UnplacedObject
from .photo_camera import View
from .photograph import Photograph
from .visual_hull import HullError

log = logging.getLogger("vgmpi.apps.photo")

Guess = tuple[tuple, Any, str]
MIN_IOU = 0.7  # [-] bodies below this intersection over union hardly fit their masks


class Scenery(NamedTuple):
    """Common input of all bodies."""

    loaded: LoadedLayout
    photo: Photograph
    view: View
    out: Path  # folder of the scene


def make_bodies(
    scenery: Scenery, masks: list[ObjectMask], guesses: list[Guess]
) -> list[UnplacedObject]:
    """Make the bodies of all objects and append the guesses.

    Raises:
        LayoutError: A body cannot be made.
        OSError: A file cannot be read or written.
    """
    return [
        UnplacedObject(obj, _body(k, obj, scenery, object_mask.mask, guesses))
        for k, (obj, object_mask) in enumerate(zip(scenery.loaded.layout.object, masks))
    ]


def _body(
    k: int, obj: ObjectTable, scenery: Scenery, mask: np.ndarray, guesses: list[Guess]
) -> GaussianCloud:
    """Return the Gaussians of one object about the eye.

    Args:
        k: Index of the object.
        obj: Table of the object.
        scenery: Common input.
        mask: The object, shape (height, width) bool.
        guesses: Guesses, to which the found pose is appended (in/out).
    """
    config = scenery.loaded.layout.bodies
    key = "body"
    up: str | None = obj.up
    try:
        file = _body_file(obj, scenery.loaded)
        if file is not None:
            cloud = _read_body(file)
            log.info("'%s': the body in %s, %d Gaussians", obj.name, file, len(cloud))
        elif obj.multi_view is not None:
            key, up = "multi_view", up or "z"
            cloud = visual_hull.body(
                visual_hull.read(scenery.loaded.path(obj.multi_view)), k + 1, up
            )
            log.info("'%s': the hull of %s, %d Gaussians", obj.name, obj.multi_view, len(cloud))
        elif obj.reconstruction is None and config.method != "mask":
            cloud = _body_from_generator(obj, scenery, mask)
            up = up or external_generators.KINDS[config.method].up
        else:
            key = "reconstruction"
            return _body_from_mask(k, obj, scenery, mask, guesses)
    except (BodyError, HullError, GaussianFileError, MeshError) as error:
        raise scenery.loaded.wrong((("object", k, key), str(error))) from None
    except GeneratorError as error:
        path = ("bodies", error.key) if error.key else ("object", k)
        raise scenery.loaded.wrong((path, str(error))) from None
    aligned = pose_search.align_to_photo(cloud, scenery.photo.rgb, mask, scenery.view, up, obj.yaw)
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


def _body_from_mask(
    k: int, obj: ObjectTable, scenery: Scenery, mask: np.ndarray, guesses: list[Guess]
) -> GaussianCloud:
    """Make a body from the mask alone.

    Raises:
        BodyError: The mask gives no body.
    """
    method, thickness = obj.reconstruction or "inflate", obj.thickness
    if obj.reconstruction is None:
        guesses.append((("object", k, "reconstruction"), method, "guessed: the usual one"))
    if thickness is None:
        thickness = mask_to_mesh.THICKNESS
        if method == "extrude":
            guesses.append((("object", k, "thickness"), thickness, "of its width, guessed"))
    surface = mask_to_mesh.body(mask, scenery.view, method, thickness)
    cloud = gaussian_colors.gaussians(surface, scenery.photo.rgb, mask, scenery.view, seed=k + 1)
    log.info("'%s': %s, %d Gaussians", obj.name, method, len(cloud))
    if obj.yaw:
        rotation = axis_rotation((0.0, 0.0, 1.0), np.radians(obj.yaw))
        middle = (cloud.x.min(axis=0) + cloud.x.max(axis=0)) / 2
        cloud = cloud.transformed(rotation, 1.0, middle - rotation @ middle)
    return cloud


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
    for suffix in (*registry.KINDS, *surface_mesh.FORMATS):
        if (folder / f"{obj.name}{suffix}").is_file():
            return folder / f"{obj.name}{suffix}"
    log.info("'%s': no file of its name in %s", obj.name, config.folder)
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
            return registry.read(file)
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
