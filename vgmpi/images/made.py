"""A photograph and its layout become a folder with a scene."""

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import Cloud
from vgmpi.images import (
    airborne,
    found,
    models,
    photograph,
    placing,
    proposed,
    scenes,
    shown,
    sources,
    stuff,
)
from vgmpi.images import layout as layouts
from vgmpi.images.background import painted_out
from vgmpi.images.files import Folder
from vgmpi.images.layout import LayoutError, Told
from vgmpi.images.masks import MaskError
from vgmpi.images.models import Models
from vgmpi.images.photograph import Photograph
from vgmpi.images.placing import PlacingError, Seen
from vgmpi.images.sources import Guess, Scenery
from vgmpi.images.view import View
from vgmpi.scene.reader import load
from vgmpi.tables import SceneError

log = logging.getLogger("vgmpi.images")

FOV, PITCH = 50.0, 15.0  # degrees, where nothing is known of the camera


class Made(NamedTuple):
    """What came out. alike: how much the first frame looks like the photograph inside each mask
    [dB]."""

    names: list[str]
    alike: list[float]


def make(photo_path: Path, layout_path: Path, out: Path, overwrite: bool = False) -> Made:
    """All of it. Raises LayoutError, PhotographError, MaskError, OSError; nothing is written then,
    but the bodies that generators have made."""
    photo = photograph.read(photo_path)
    told = layouts.read(layout_path)
    folder = Folder(out, overwrite)
    names = [thing.name for thing in told.layout.object]
    asked = models.load(told)
    masks = found.find(told, photo, asked.finder)
    found.hidden(masks, names)
    guesses: list[Guess] = []
    view = _view(told, photo, guesses)
    seen = sources.all_of(Scenery(told, photo, view, out), masks, guesses)
    seen, eye = _lifted(told, photo, view, seen, masks, asked, guesses)
    placed = _placed(told, view, seen, eye)
    materials = _materials(told, photo, masks, asked, guesses)
    _tell(told, view, placed, guesses)
    eye_at = np.array([0.0, 0.0, placed.eye])
    things = [
        _thing(thing.name, stand.cloud, eye_at, name)
        for thing, stand, name in zip(told.layout.object, placed.stands, materials)
    ]
    wanted = told.layout.scene
    space = scenes.room(things, wanted.cells)
    every = [one.mask for one in masks]
    background = painted_out(photo.rgb, every)
    camera = view.camera(eye_at, scenes.near(eye_at))
    clouds = [one.cloud.transformed(np.eye(3), 1.0, one.at) for one in things]
    drawn = shown.frame(clouds, camera, background / 255.0)
    alike = [shown.alike(drawn, photo.rgb, mask) for mask in every]
    for thing, mask in zip(things, masks):
        folder.picture(f"masks/{thing.name}.png", np.where(mask.mask, 255, 0).astype(np.uint8))
        folder.picture(f"crops/{thing.name}.png", shown.crop(photo.rgb, mask.mask))
        folder.gaussians(f"{thing.name}.ply", thing.cloud)
        if not mask.given:
            k = names.index(thing.name)
            where = layouts.relative(out / "masks" / f"{thing.name}.png", told.source.folder)
            guesses.append((("object", k, "mask"), where, mask.how))
    folder.picture("background.png", background)
    folder.picture("check.png", shown.beside(photo.rgb, drawn, every))
    folder.text("render.toml", scenes.render(view, eye_at - space.low, "background.png"))
    title = f"from {photo_path.name}"
    folder.text("scene.toml", scenes.scene(things, space, wanted.end, wanted.frames, title))
    folder.whole(layout_path, layouts.rewritten(told.source.text, guesses))
    folder.write()
    _checked(out)
    for name, value in zip(names, alike):
        log.info("'%s': the first frame agrees with the photograph to %.1f dB", name, value)
    return Made(names, alike)


def propose(photo_path: Path, layout_path: Path | None, out: Path) -> Path:
    """Write a layout with boxes of what may be objects, and find.png with them; returns the
    layout's path. layout_path: a layout without objects, or where one shall be; default: in `out`.
    Raises LayoutError, PhotographError, MaskError, OSError."""
    photo = photograph.read(photo_path)
    where = layout_path if layout_path is not None else out / "layout.toml"
    empty, source = layouts.read_empty(where) if where.exists() else (layouts.Empty(), None)
    folder = Folder(out, overwrite=True)
    boxes = models.proposer(empty, source.folder if source else where.parent)(photo.rgb)
    if not boxes:
        raise MaskError(f"{photo_path}: nothing in it stands out: boxes must be given by hand")
    for k, box in enumerate(boxes):
        size = f"{box.right - box.left} x {box.bottom - box.top} pixels"
        log.info("'thing %d': proposed, %s, as it stands out from its rows", k + 1, size)
    folder.picture("find.png", proposed.drawn(photo.rgb, boxes))
    folder.whole(where, proposed.text(boxes, photo, source.text if source else ""))
    folder.write()
    return where


def _view(told: Told, photo: Photograph, guesses: list[Guess]) -> View:
    """The photograph's camera, guessed where the layout does not tell."""
    asked = told.layout.camera
    height, width = photo.rgb.shape[:2]
    fov, pitch = asked.fov, asked.pitch
    if fov is None:
        fov, why = (photo.fov, "the photograph's EXIF") if photo.fov else (FOV, "a usual lens")
        fov = round(min(max(fov, 5.0), 140.0), 3)
        guesses.append((("camera", "fov"), fov, f"degrees, guessed: {why}"))
        log.info("camera: fov %g degrees, guessed: %s", fov, why)
    if pitch is None:
        pitch, why = PITCH, "as one looks at a table"
        guesses.append((("camera", "pitch"), pitch, f"degrees, guessed: {why}"))
        log.info("camera: pitch %g degrees, guessed: %s", pitch, why)
    return View(width, height, fov, pitch)


def _placed(told: Told, view: View, seen: list[Seen], eye: float | None) -> placing.Placed:
    """The places of all objects, told line by line."""
    try:
        placed = placing.place(seen, view.forward, eye)
    except PlacingError as error:
        k = [thing.name for thing in told.layout.object].index(error.name)
        raise told.wrong((("object", k, error.key), str(error))) from None
    for line in placed.lines:
        log.info("%s", line)
    return placed


def _lifted(
    told: Told, photo: Photograph, view: View, seen: list[Seen], masks: list[found.Found],
    asked: Models, guesses: list[Guess],
) -> tuple[list[Seen], float | None]:  # fmt: skip
    """The objects with the heights of what a model sees in the air, and of the eye above the floor
    where it is known by then."""
    eye = told.layout.camera.height
    if asked.depth is None or all(one.asked.support is not None for one in seen):
        return seen, eye
    nearness = asked.depth.nearness(photo.rgb)
    fit = airborne.floor_fit(nearness, [one.mask for one in masks], view)
    if fit is None:
        log.warning("depth: too little of the floor is seen: all objects stand on it")
        return seen, eye
    lifts = [
        airborne.lift(nearness, mask.mask, one.low[2], one.front(view.forward), fit)
        if one.asked.support is None
        else None
        for one, mask in zip(seen, masks)
    ]
    standing = [one for one, up in zip(seen, lifts) if up is None]
    if eye is None and any(one.asked.height for one in standing):
        eye = placing.place(standing, view.forward, None).eye
    if eye is None:
        log.warning("depth: how high the camera is, no object tells that stands: nothing is lifted")
        return seen, eye
    out = []
    for k, (one, up) in enumerate(zip(seen, lifts)):
        if up is not None:
            height = _short(up[0] * eye)
            why = f"m above the floor, as depths have it: {up[1] * eye:.3g} m away"
            guesses.append((("object", k, "support"), height, why))
            log.info("'%s': its lowest point is %g %s", one.asked.name, height, why)
            one = one._replace(asked=one.asked.model_copy(update={"support": height}))
        out.append(one)
    return out, eye


def _tell(told: Told, view: View, placed: placing.Placed, guesses: list[Guess]) -> None:
    """The places as guesses of the layout."""
    if told.layout.camera.height is None:
        value = _short(placed.eye)
        guesses.append((("camera", "height"), value, "m above the floor, from what is known"))
    for k, (thing, stand) in enumerate(zip(told.layout.object, placed.stands)):
        low, high = stand.floor_box(placed.eye)
        lifted = any(path == ("object", k, "support") for path, *_ in guesses)
        if thing.support is None and not lifted:
            guesses.append((("object", k, "support"), layouts.FLOOR, "guessed: it stands"))
        if thing.height is None:
            guesses.append((("object", k, "height"), _short(high[2] - low[2]), "m, as it is seen"))
        if thing.distance is None:
            value = _short(stand.distance(view.forward))
            guesses.append((("object", k, "distance"), value, "m from the eye along its axis"))


def _materials(
    told: Told, photo: Photograph, masks: list[found.Found], asked: Models, guesses: list[Guess]
) -> list[str]:
    """The names of what all objects are made of."""
    names, wrong = [], []
    for k, (thing, one) in enumerate(zip(told.layout.object, masks)):
        name = thing.material
        if name is None:
            name, why = stuff.guessed(thing.name, thing.text)
            if asked.clip is not None:
                ranks = asked.clip.ranked(shown.crop(photo.rgb, one.mask), stuff.words())
                name, why = stuff.ranked(ranks)
            guesses.append((("object", k, "material"), name, f"guessed: {why}"))
            log.info("'%s': %s, guessed: %s", thing.name, name, why)
        else:
            try:
                stuff.keys(name)
            except ValueError as error:
                wrong.append((("object", k, "material"), str(error)))
        names.append(name)
    if wrong:
        raise told.wrong(*wrong)
    return names


def _thing(name: str, cloud: Cloud, eye: np.ndarray, material: str) -> scenes.Thing:
    """An object as the scene has it: about the middle of its base."""
    low, high = cloud.x.min(axis=0), cloud.x.max(axis=0)
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    own = cloud.transformed(np.eye(3), 1.0, -base)
    return scenes.Thing(name, own, base + eye, material, stuff.keys(material))


def _checked(out: Path) -> None:
    """The scene is right, which is only to be seen when its files are there. Raises LayoutError."""
    try:
        load(out / "scene.toml")
    except SceneError as error:
        raise LayoutError(error.lines) from None


def _short(value: float) -> float:
    """In five digits."""
    return float(f"{value:.5g}")
