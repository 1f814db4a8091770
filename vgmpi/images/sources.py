"""The bodies of a layout's objects, from whoever makes them, about the eye."""

import io
import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians import files
from vgmpi.gaussians.checked import GaussianFileError
from vgmpi.gaussians.cloud import Cloud
from vgmpi.images import bodies, colours, facing, generators, hull, shown
from vgmpi.images.bodies import BodyError
from vgmpi.images.found import Found
from vgmpi.images.generators import GeneratorError
from vgmpi.images.hull import HullError
from vgmpi.images.layout import LayoutError, ObjectTable, Told
from vgmpi.images.photograph import Photograph
from vgmpi.images.placing import Seen
from vgmpi.images.view import View
from vgmpi.prepare import mesh
from vgmpi.prepare.mesh import MeshError
from vgmpi.prepare.place import axis_rotation

log = logging.getLogger("vgmpi.images")

Guess = tuple[tuple, Any, str]
WEAK = 0.7  # intersection over union below which a body hardly fits its mask


class Scenery(NamedTuple):
    """What all bodies are made from; out: the folder of the scene."""

    told: Told
    photo: Photograph
    view: View
    out: Path


def all_of(at: Scenery, masks: list[Found], guesses: list[Guess]) -> list[Seen]:
    """The bodies of all objects; what was guessed is added. Raises LayoutError, OSError."""
    return [
        Seen(thing, _one(k, thing, at, one.mask, guesses))
        for k, (thing, one) in enumerate(zip(at.told.layout.object, masks))
    ]


def _one(k: int, thing: ObjectTable, at: Scenery, mask: np.ndarray, guesses: list[Guess]) -> Cloud:
    """The Gaussians of one object about the eye."""
    asked = at.told.layout.bodies
    key = "body"
    up: str | None = thing.up
    try:
        file = _file(thing, at.told)
        if file is not None:
            made = _read(file)
            log.info("'%s': the body in %s, %d Gaussians", thing.name, file, len(made))
        elif thing.views is not None:
            key, up = "views", up or "z"
            made = hull.body(hull.read(at.told.path(thing.views)), k + 1, up)
            log.info("'%s': the hull of %s, %d Gaussians", thing.name, thing.views, len(made))
        elif thing.form is None and asked.by != "form":
            made = _generated(thing, at, mask)
            up = up or generators.KINDS[asked.by].up
        else:
            key = "form"
            return _formed(k, thing, at, mask, guesses)
    except (BodyError, HullError, GaussianFileError, MeshError) as error:
        raise at.told.wrong((("object", k, key), str(error))) from None
    except GeneratorError as error:
        where = ("bodies", error.key) if error.key else ("object", k)
        raise at.told.wrong((where, str(error))) from None
    faced = facing.face(made, at.photo.rgb, mask, at.view, up, thing.yaw)
    pose = faced.pose
    how = f"outline agrees to {pose.alike:.2f}, colours differ by {pose.off:.2f}"
    log.info("'%s': up %s, yaw %g degrees: %s", thing.name, pose.up, pose.yaw, how)
    if pose.alike < WEAK:
        log.warning("'%s': hardly fits its mask (%.2f): another body?", thing.name, pose.alike)
    if thing.up is None:
        guesses.append((("object", k, "up"), pose.up, f"axis of its file, found: {how}"))
    if thing.yaw is None:
        guesses.append((("object", k, "yaw"), pose.yaw, f"degrees, found: {how}"))
    return faced.cloud


def _formed(
    k: int, thing: ObjectTable, at: Scenery, mask: np.ndarray, guesses: list[Guess]
) -> Cloud:
    """A body made of the mask alone. Raises BodyError."""
    form, thick = thing.form or "inflate", thing.thickness
    if thing.form is None:
        guesses.append((("object", k, "form"), form, "guessed: the usual one"))
    if thick is None:
        thick = bodies.THICKNESS
        if form == "extrude":
            guesses.append((("object", k, "thickness"), thick, "of its width, guessed"))
    surface = bodies.body(mask, at.view, form, thick)
    cloud = colours.gaussians(surface, at.photo.rgb, mask, at.view, seed=k + 1)
    log.info("'%s': %s, %d Gaussians", thing.name, form, len(cloud))
    if thing.yaw:
        turn = axis_rotation((0.0, 0.0, 1.0), np.radians(thing.yaw))
        middle = (cloud.x.min(axis=0) + cloud.x.max(axis=0)) / 2
        cloud = cloud.transformed(turn, 1.0, middle - turn @ middle)
    return cloud


def _file(thing: ObjectTable, told: Told) -> Path | None:
    """The file that has an object's body, if there is one."""
    if thing.body is not None:
        return told.path(thing.body)
    asked = told.layout.bodies
    if not asked.folder or thing.form is not None or thing.views is not None:
        return None
    folder = told.path(asked.folder)
    if not folder.is_dir():
        raise LayoutError(told.source.lines([(("bodies", "folder"), f"no folder {folder}")]))
    for suffix in (*files.KINDS, *mesh.FORMATS):
        if (folder / f"{thing.name}{suffix}").is_file():
            return folder / f"{thing.name}{suffix}"
    log.info("'%s': no file of its name in %s", thing.name, asked.folder)
    return None


def _read(file: Path) -> Cloud:
    """Gaussians, or a mesh as Gaussians. Raises GaussianFileError, MeshError."""
    suffix = file.suffix.lower()
    if suffix not in (*files.KINDS, *mesh.FORMATS):
        known = ", ".join(dict.fromkeys((*files.KINDS, *mesh.FORMATS)))
        raise MeshError(f"{file}: allowed: a name that ends in {known}")
    try:
        if suffix in files.KINDS:
            return files.read(file)
    except GaussianFileError as error:
        if suffix != ".ply" or "mesh" not in str(error) and "not a cloud" not in str(error):
            raise
    if not file.is_file():
        raise MeshError(f"{file}: no such file")
    found = mesh.read(file)
    extent = float(np.ptp(found.points[found.triangles.ravel()], axis=0).max())
    return mesh.sample(found, extent / 100, (0.7, 0.7, 0.7), colours.OPACITY, [1])


def _generated(thing: ObjectTable, at: Scenery, mask: np.ndarray) -> Cloud:
    """What a generator makes of the object's crop. Raises GeneratorError, OSError."""
    from PIL import Image

    held = io.BytesIO()
    Image.fromarray(shown.crop(at.photo.rgb, mask)).save(held, "png")
    beside = at.told.source.folder
    return generators.make(thing.name, held.getvalue(), at.told.layout.bodies, beside, at.out)
