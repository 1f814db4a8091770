"""Texts of scene.toml and render.toml for objects in their places."""

import zlib
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime.config import toml_writer

from .photo_camera import View

SIDE_MARGIN, TOP_MARGIN = (
    0.8,
    0.3,
)  # [-] margins around the objects relative to the largest extent of one
FLOOR_GAP = 0.2  # [cells] between the objects and the floor, because soft bodies sink in a little
# bodies that do not tear: their colors are fitted to the photograph without what fills them
INTACT_KINDS = ("elastic", "corotated")
FRICTION = 0.4  # [-] friction coefficient of the floor
_MARK = "# made by python -m vgmpi photo, sum "


class SceneObject(NamedTuple):
    """Object of the scene."""

    name: str
    cloud: GaussianCloud  # [m] about the middle of the object's base
    position: np.ndarray  # (3,) [m] position of the middle of the base, above the floor
    material: str  # name of the material
    keys: dict[str, Any]  # keys of the material in the scene
    is_hollow: bool = False  # whether only what its surface encloses is filled


class Domain(NamedTuple):
    """Simulation domain."""

    low: np.ndarray  # (3,) [m] lower corner, above the floor
    counts: np.ndarray  # (3,) cells along each edge
    cell: float  # [m] cell size


def domain_around(objects: list[SceneObject], cells: int) -> Domain:
    """Return a domain around all objects, with the floor at its lower wall.

    Args:
        objects: Objects in their places.
        cells: Cells along the longest edge.
    """
    low = np.min([obj.position + obj.cloud.x.min(axis=0) for obj in objects], axis=0)
    high = np.max([obj.position + obj.cloud.x.max(axis=0) for obj in objects], axis=0)
    max_extent = max(float(np.ptp(obj.cloud.x, axis=0).max()) for obj in objects)
    low[:2] -= SIDE_MARGIN * max_extent
    high[:2] += SIDE_MARGIN * max_extent
    low[2], high[2] = 0.0, high[2] + TOP_MARGIN * max_extent
    cell = float(f"{(high - low).max() / cells * 1.0005:.3g}")
    counts = np.ceil((high - low) / cell).astype(int)
    middle = (low + high)[:2] / 2
    low[:2] = middle - counts[:2] * cell / 2
    low[2] = -FLOOR_GAP * cell
    return Domain(low, counts, cell)


def scene(objects: list[SceneObject], domain: Domain, end: float, frames: int, title: str) -> str:
    """Return the text of scene.toml, with the Gaussians in NAME.ply beside it.

    Args:
        objects: Objects in their places.
        domain: Simulation domain.
        end: End time [s].
        frames: Number of frames.
        title: Title of the scene.
    """
    materials = {obj.material: obj.keys for obj in objects}
    top = {
        "title": title,
        "domain": {
            "size": [float(f"{n * domain.cell:.12g}") for n in domain.counts],
            "cell": domain.cell,
            "boundary": {"default": "open", "bottom": {"kind": "separate", "friction": FRICTION}},
        },
        "time": {"end": end, "frames": frames},
        "appearance": {"color_transfer": "off"},
        "material": materials,
        "object": [
            {
                "name": obj.name,
                "material": obj.material,
                "gaussians": f"{obj.name}.ply",
                "position": [round(float(c), 9) for c in obj.position - domain.low],
                **({"fill": "closed"} if obj.is_hollow else {}),
                **({"opacity": 0.0} if obj.keys["kind"] in INTACT_KINDS else {}),
            }
            for obj in objects
        ],
    }
    head = [
        "The scene of a photograph. What was guessed stands in layout.toml: change it there and",
        "start again; or change this file, which is then not replaced without --overwrite.",
    ]
    return with_checksum(toml_writer.text(top, head, []))


def render(
    view: View, eye: np.ndarray, background: str, light: dict[str, Any], shadows: str
) -> str:
    """Return the text of render.toml: the photograph's camera and light.

    Args:
        view: Camera of the photograph.
        eye: Position of the camera in the domain, shape (3,) [m].
        background: File of the background.
        light: Table [light], empty for the usual light.
        shadows: "keep": the background holds the first shadows; "remove": all are drawn, if a light
            is known.
    """
    with_shadows = bool(light) and shadows == "remove"
    floor = {"height": 0.0} if with_shadows else {"kind": "photograph"}
    top = {
        "camera": {
            "kind": "fixed",
            "eye": [round(float(c), 9) for c in eye],
            "target": [round(float(c), 9) for c in eye + view.forward],
            "fov": view.fov,
            "near": near_plane(eye),
        },
        "picture": {
            "width": view.width,
            "height": view.height,
            "background": background,
            "floor": floor,
        },
        **({"light": {**light, "captures": 0.0}} if light else {}),
    }
    first = "and no shadows" if with_shadows else "and the photograph holds their first shadows"
    thrown = "all shadows are drawn" if with_shadows else "only shadows that come later are drawn"
    head = [
        "The photograph's camera; behind everything the photograph, its objects painted out. The",
        f"light is in their colors, {first}: no light is",
        f"added to them, and {thrown}.",
    ]
    return with_checksum(toml_writer.text(top, head, []))


def near_plane(eye: np.ndarray) -> float:
    """Return the distance of the near plane [m]."""
    return float(f"{min(0.2, 0.05 * max(float(eye[2]), 1e-6)):.6g}")


def with_checksum(text: str) -> str:
    """Prepend a line with a checksum that reveals later changes of the text."""
    return f"{_MARK}{zlib.crc32(text.encode()):08x}\n{text}"


def is_unchanged(text: str) -> bool:
    """Return whether a text was written by this command and is unchanged."""
    first, _, body = text.partition("\n")
    return first.startswith(_MARK) and first == f"{_MARK}{zlib.crc32(body.encode()):08x}"
