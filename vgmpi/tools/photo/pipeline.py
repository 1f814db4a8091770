"""Pipeline from a photograph and its layout to a folder with a scene.

`photo_to_scene` and `propose` raise LayoutError, PhotographError, MaskError or OSError; then
nothing has been written but the bodies from generators.
"""

import logging
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load

from . import (
    body_sources,
    box_proposals,
    layout_config,
    layout_text,
    learned_models,
    material_lookup,
    object_masks,
    object_placement,
    photograph,
    preview,
    scene_writer,
)
from .body_sources import Guess, Scenery
from .camera_guess import guess_view
from .gaussian_colors import correct_colors
from .grabcut import MaskError
from .layout_config import LayoutError, LoadedLayout
from .learned_models import Models
from .object_placement import PlacingError, UnplacedObject
from .output_folder import Folder
from .photo_camera import View
from .photograph import Photograph
from .scene_light import background_and_light, render_keys

log = logging.getLogger("vgmpi.tools.photo")


class PhotoScene(NamedTuple):
    """Objects of the finished scene and their agreement with the photograph."""

    names: list[str]
    psnr: list[float]  # [dB] PSNR of the first frame inside each mask


def photo_to_scene(
    photo_path: Path, layout_path: Path, out: Path, overwrite: bool = False
) -> PhotoScene:
    """Convert a photograph and its layout into a scene.

    Args:
        photo_path: The photograph.
        layout_path: The layout; guesses are written into it.
        out: Folder of the scene.
        overwrite: Whether to replace a scene that was changed.
    """
    layout_text.import_tomlkit()  # what it is for comes last
    photo = photograph.read(photo_path)
    loaded = layout_config.read(layout_path)
    folder = Folder(out, overwrite)
    names = [obj.name for obj in loaded.layout.object]
    learned = learned_models.load(loaded)
    masks = object_masks.segment_objects(loaded, photo, learned.finder)
    object_masks.overlapping_masks(masks, loaded.layout.object)
    guesses: list[Guess] = []
    mask_images = [object_mask.mask for object_mask in masks]
    view = guess_view(loaded, photo, mask_images, guesses)
    unplaced = body_sources.make_bodies(Scenery(loaded, photo, view, out, {}), masks, guesses)
    unplaced, eye = _apply_depth(loaded, photo, view, unplaced, masks, learned, guesses)
    placed = _placed(loaded, view, unplaced, eye)
    materials = _materials(loaded, photo, masks, learned, guesses)
    _record_guesses(loaded, view, placed, guesses)
    eye_at = np.array([0.0, 0.0, placed.eye])
    scene_objects = [
        _scene_object(obj, placed_obj.cloud, eye_at, name)
        for obj, placed_obj, name in zip(loaded.layout.object, placed.objects, materials)
    ]
    requested = loaded.layout.scene
    domain = scene_writer.domain_around(scene_objects, requested.cells)
    camera = view.camera(eye_at, scene_writer.near_plane(eye_at))
    clouds = [entity.cloud.transformed(np.eye(3), 1.0, entity.position) for entity in scene_objects]
    background, light = background_and_light(loaded, photo, mask_images, clouds, camera, guesses)
    scene_objects, rendered = _first_frame(
        loaded, photo, mask_images, scene_objects, clouds, camera, background
    )
    _add_objects(folder, photo, loaded, masks, scene_objects, guesses)
    folder.picture("background.png", background)
    folder.picture("check.png", preview.comparison_image(photo.rgb, rendered, mask_images))
    render_text = scene_writer.render(
        view, eye_at - domain.low, "background.png", render_keys(light), requested.shadows
    )
    folder.text("render.toml", render_text)
    title = f"from {photo_path.name}"
    scene_text = scene_writer.scene(scene_objects, domain, requested.end, requested.frames, title)
    folder.text("scene.toml", scene_text)
    folder.text_file(layout_path, layout_text.insert_guesses(loaded.source.text, guesses))
    folder.write()
    _validate_scene(out)
    return _agreement(names, rendered, photo.rgb, mask_images)


def propose(photo_path: Path, layout_path: Path | None, out: Path) -> Path:
    """Write a layout with boxes of possible objects, and find.png that shows them.

    Args:
        photo_path: The photograph.
        layout_path: Layout without objects, or path of a new one; default: layout.toml in `out`.
        out: Output folder.

    Returns:
        Path of the layout.

    Raises:
        LayoutError: The layout is invalid or has objects already.
        PhotographError: The photograph is unusable.
        MaskError: Nothing stands out in the photograph.
        OSError: A file cannot be written.
    """
    photo = photograph.read(photo_path)
    path = layout_path if layout_path is not None else out / "layout.toml"
    empty, source = (
        layout_config.read_empty(path) if path.exists() else (layout_config.Empty(), None)
    )
    folder = Folder(out, overwrite=True)
    boxes = learned_models.proposer(empty, source.folder if source else path.parent)(photo.rgb)
    if not boxes:
        raise MaskError(f"{photo_path}: nothing in it stands out: boxes must be given by hand")
    for k, box in enumerate(boxes):
        size = f"{box.right - box.left} x {box.bottom - box.top} pixels"
        log.info("'thing %d': proposed, %s, as it stands out", k + 1, size)
    folder.picture("find.png", box_proposals.draw_boxes(photo.rgb, boxes))
    folder.text_file(path, box_proposals.text(boxes, photo, source.text if source else ""))
    folder.write()
    return path


def _add_objects(
    folder: Folder,
    photo: Photograph,
    loaded: LoadedLayout,
    masks: list[object_masks.ObjectMask],
    scene_objects: list[scene_writer.SceneObject],
    guesses: list[Guess],
) -> None:
    """Add masks, crops and bodies of all objects to the folder, and the masks to the guesses."""
    for k, (entity, mask) in enumerate(zip(scene_objects, masks)):
        folder.picture(f"masks/{entity.name}.png", np.where(mask.mask, 255, 0).astype(np.uint8))
        folder.picture(f"crops/{entity.name}.png", preview.crop(photo.rgb, mask.mask))
        folder.gaussians(f"{entity.name}.ply", entity.cloud)
        if not mask.is_from_file:
            path = folder.out / "masks" / f"{entity.name}.png"
            where = layout_text.relative(path, loaded.source.folder)
            guesses.append((("object", k, "mask"), where, mask.origin))


def _first_frame(
    loaded: LoadedLayout,
    photo: Photograph,
    mask_images: list[np.ndarray],
    scene_objects: list[scene_writer.SceneObject],
    clouds: list[GaussianCloud],
    camera: Camera,
    background: np.ndarray,
) -> tuple[list[scene_writer.SceneObject], np.ndarray]:
    """Return the objects with corrected colors, and the first frame (height, width, 3) in 0..1.

    The clouds are those of the objects, in their places.
    """
    own_masks = [
        mask if body_sources.is_from_mask(obj, loaded) else None
        for obj, mask in zip(loaded.layout.object, mask_images)
    ]
    clouds = correct_colors(clouds, own_masks, camera, photo.rgb, background)
    corrected = [
        entity._replace(cloud=replace(entity.cloud, sh=cloud.sh))
        for entity, cloud in zip(scene_objects, clouds)
    ]
    return corrected, preview.frame(clouds, camera, background / 255.0)


def _placed(
    loaded: LoadedLayout, view: View, unplaced: list[UnplacedObject], eye: float | None
) -> object_placement.Placement:
    """Place all objects and log each decision."""
    try:
        placed = object_placement.place(unplaced, view.forward, eye)
    except PlacingError as error:
        k = [obj.name for obj in loaded.layout.object].index(error.name)
        raise loaded.wrong((("object", k, error.key), str(error))) from None
    for line in placed.lines:
        log.info("%s", line)
    return placed


def _apply_depth(
    loaded: LoadedLayout, photo: Photograph, view: View, unplaced: list[UnplacedObject],
    masks: list[object_masks.ObjectMask], learned: Models, guesses: list[Guess],
) -> tuple[list[UnplacedObject], float | None]:  # fmt: skip
    """Raise objects that a depth model sees in the air.

    Returns:
        The objects with their heights as supports, and the height of the eye [m] or None.
    """
    eye = loaded.layout.camera.height
    if learned.depth is None or all(obj.config.support is not None for obj in unplaced):
        return unplaced, eye
    nearness = learned.depth.nearness(photo.rgb)
    fit = object_placement.fit_ground_depth(nearness, [mask.mask for mask in masks], view)
    if fit is None:
        log.warning("depth: too little of the floor is seen: all objects stand on it")
        return unplaced, eye
    lifts = [
        object_placement.height_above_ground(
            nearness, mask.mask, obj.low[2], obj.front(view.forward), fit
        )
        if obj.config.support is None
        else None
        for obj, mask in zip(unplaced, masks)
    ]
    grounded = [obj for obj, lifted in zip(unplaced, lifts) if lifted is None]
    if eye is None and any(obj.config.height for obj in grounded):
        eye = object_placement.place(grounded, view.forward, None).eye
    if eye is None:
        log.warning("depth: how high the camera is, no object tells that stands: nothing is lifted")
        return unplaced, eye
    out = []
    for k, (obj, lifted) in enumerate(zip(unplaced, lifts)):
        if lifted is not None:
            height = _five_digits(lifted[0] * eye)
            reason = f"m above the floor, as depths have it: {lifted[1] * eye:.3g} m away"
            guesses.append((("object", k, "support"), height, reason))
            log.info("'%s': its lowest point is %g %s", obj.config.name, height, reason)
            obj = obj._replace(config=obj.config.model_copy(update={"support": height}))
        out.append(obj)
    return out, eye


def _record_guesses(
    loaded: LoadedLayout, view: View, placed: object_placement.Placement, guesses: list[Guess]
) -> None:
    """Add the placement to the guesses for the layout."""
    if loaded.layout.camera.height is None:
        value = _five_digits(placed.eye)
        guesses.append((("camera", "height"), value, "m above the floor, from what is known"))
    for k, (obj, placed_obj) in enumerate(zip(loaded.layout.object, placed.objects)):
        low, high = placed_obj.floor_box(placed.eye)
        lifted = any(path == ("object", k, "support") for path, *_ in guesses)
        if obj.inside is not None:
            continue
        if obj.support is None and not lifted:
            guesses.append((("object", k, "support"), layout_config.FLOOR, "guessed: it stands"))
        if obj.height is None:
            guesses.append(
                (("object", k, "height"), _five_digits(high[2] - low[2]), "m, as it is seen")
            )
        if obj.distance is None:
            value = _five_digits(placed_obj.distance(view.forward))
            guesses.append((("object", k, "distance"), value, "m from the eye along its axis"))


def _materials(
    loaded: LoadedLayout,
    photo: Photograph,
    masks: list[object_masks.ObjectMask],
    learned: Models,
    guesses: list[Guess],
) -> list[str]:
    """Return the material names of all objects, guessed where the layout gives none."""
    names, errors = [], []
    for k, (obj, object_mask) in enumerate(zip(loaded.layout.object, masks)):
        name = obj.material
        if name is None:
            name, reason = material_lookup.guess_from_name(obj.name, obj.text)
            if learned.clip is not None:
                ranks = learned.clip.ranked(
                    preview.crop(photo.rgb, object_mask.mask), material_lookup.words()
                )
                name, reason = material_lookup.guess_from_ranking(ranks)
            guesses.append((("object", k, "material"), name, f"guessed: {reason}"))
            log.info("'%s': %s, guessed: %s", obj.name, name, reason)
        else:
            try:
                material_lookup.material_keys(name)
            except ValueError as error:
                errors.append((("object", k, "material"), str(error)))
        names.append(name)
    if errors:
        raise loaded.wrong(*errors)
    return names


def _scene_object(
    obj: layout_config.ObjectTable, cloud: GaussianCloud, eye: np.ndarray, material: str
) -> scene_writer.SceneObject:
    """Return the object of the scene, with its Gaussians about the middle of its base."""
    low, high = cloud.x.min(axis=0), cloud.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    own = cloud.transformed(np.eye(3), 1.0, -base)
    return scene_writer.SceneObject(
        obj.name,
        own,
        base + eye,
        material,
        material_lookup.material_keys(material),
        is_hollow=obj.reconstruction == "cup",
    )


def _agreement(
    names: list[str], rendered: np.ndarray, rgb: np.ndarray, masks: list[np.ndarray]
) -> PhotoScene:
    """Return and log how the first frame (height, width, 3) agrees with the photograph."""
    psnr = [preview.psnr_in_mask(rendered, rgb, mask) for mask in masks]
    total = preview.psnr_in_mask(rendered, rgb, np.ones(rgb.shape[:2], bool))
    for name, value in zip(names, psnr):
        log.info("'%s': the first frame agrees with the photograph to %.1f dB", name, value)
    log.info("picture: the first frame agrees with the photograph to %.1f dB", total)
    return PhotoScene(names, psnr)


def _validate_scene(out: Path) -> None:
    """Load the finished scene, which can only be validated with its files.

    Raises:
        LayoutError: The scene is invalid.
    """
    try:
        load(out / "scene.toml")
    except SceneError as error:
        raise LayoutError(error.lines) from None


def _five_digits(value: float) -> float:
    """Round to five significant digits."""
    return float(f"{value:.5g}")
