"""Settings that are allowed and rarely meant: warnings, and slip walls that hold bodies back."""

import logging
import math
from typing import Any

import numpy as np

from vgmpi.materials.material import HyperelasticMaterial
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features
from vgmpi.scene.sections import WALLS

from .built_object import BuiltObject

log = logging.getLogger("vgmpi")

MIN_DOMAIN_FRACTION = 0.1  # [-] of the domain's edges, below which all objects together are small
GREENHILL = 7.837  # [-] height^3 rho g A / (E I) at which a column buckles under its own weight
TOUCHING_CELLS = 0.5  # [cells] distance of a particle from a wall that its body touches


def warn_of_locking(scene: Scene) -> None:
    """Warn of nearly incompressible materials: linear shapes in a cell lock when they bend."""
    for name, material in scene.material.items():
        ratio = getattr(material, "poisson_ratio", 0.0)
        if ratio > 0.45:
            log.warning("material '%s': poisson_ratio = %g is above 0.45: it will bend too stiffly",
                        name, ratio)  # fmt: skip


def warn_of_unlikely_objects(scene: Scene, pieces: list[BuiltObject]) -> None:
    """Warn of objects that are lost in the domain, and of bodies too soft to stand.

    Args:
        scene: The scene.
        pieces: Its objects.
    """
    _warn_of_small_objects(scene, pieces)
    gravity = math.hypot(*scene.domain.gravity)
    if not gravity or scene.domain.gravity_keyframes:
        return
    down = np.array(scene.domain.gravity) / gravity
    for k, piece in enumerate(pieces):
        if _stands_free(scene, k, piece, down):
            _warn_of_buckling(scene, k, piece, float(np.ptp(piece.cloud.x @ down)), gravity)


def _stands_free(scene: Scene, k: int, piece: BuiltObject, down: np.ndarray) -> bool:
    """Return whether a body is elastic, and free or held at its lowest point."""
    obj = scene.object[k]
    is_elastic = isinstance(scene.material.get(obj.material or ""), HyperelasticMaterial)
    if not is_elastic or obj.rigid or obj.motion is not None or not len(piece.cloud.x):
        return False
    lowest = piece.cloud.x[[np.argmax(piece.cloud.x @ down)]]
    return not any(each.hangs(obj, lowest, scene.domain.cell) for each in features())


def _warn_of_buckling(
    scene: Scene, k: int, piece: BuiltObject, height: float, gravity: float
) -> None:
    """Warn of a body that buckles under its own weight as a round column of its volume does.

    Args:
        scene: The scene.
        k: Row of the body.
        piece: The body.
        height: Its height [m].
        gravity: Acceleration of gravity [m/s2].

    References: A. G. Greenhill, Determination of the greatest height consistent with stability
        that a vertical pole or mast can be made, Proc. Cambridge Phil. Soc. 4 (1881) 65-73.
    """
    material: Any = scene.material[scene.object[k].material or ""]
    area = piece.volume.sum() / height if height else np.inf
    needed = height**3 * material.density * gravity * 4 * np.pi / (GREENHILL * area)
    if material.youngs_modulus < needed:
        log.warning(
            "%s: '%s' will fold under its own weight: it is %.3g m tall, and a column of its volume"
            ' buckles there below youngs_modulus = "%.3g kPa"; thin legs need more',
            scene.place(("object", k, "material")), scene.object[k].name, height, needed / 1000,
        )  # fmt: skip


def _warn_of_small_objects(scene: Scene, pieces: list[BuiltObject]) -> None:
    """Warn if all objects fill less than a thousandth of the domain, as if a unit were missing.

    Args:
        scene: The scene.
        pieces: Its objects.
    """
    if scene.particle_sources or any(obj.motion is not None for obj in scene.object):
        return  # what enters or moves may well need the space
    clouds = [np.reshape(piece.cloud.x, (-1, 3)) for piece in pieces if len(piece.cloud.x)]
    corners = [np.array(p.collider.ends()) for p in pieces if p.collider is not None]
    points = np.concatenate([*clouds, *corners]) if clouds or corners else np.zeros((0, 3))
    if not len(points):
        return
    extent, size = np.ptp(points, axis=0), np.array(scene.domain.size)
    if (extent < MIN_DOMAIN_FRACTION * size).all():
        log.warning(
            "%s = %.3g x %.3g x %.3g m, and all objects together are %.3g x %.3g x %.3g m: is a"
            ' unit missing? A number without one is in meters; "48 cm" has one',
            scene.place(("domain", "size")), *size, *extent,
        )  # fmt: skip


def holding_walls(scene: Scene, objects: list[dict], x: np.ndarray) -> tuple[str, ...]:
    """Return the names of the slip walls that a body touches which is not a liquid.

    Args:
        scene: The scene.
        objects: Entries of the objects and particle sources.
        x: Positions of the particles, shape (n, 3) [m].
    """
    reach, holding = TOUCHING_CELLS * scene.domain.cell, set()
    for k, entry in enumerate(objects):
        rows = x[entry["first_row"] :][: entry["row_count"]]
        if entry.get("family", "fluid") == "fluid" or not len(rows) or k >= len(scene.object):
            continue
        for wall, (kind, _) in enumerate(scene.walls_of_solids):
            axis, side = divmod(wall, 2)
            depth = (rows[:, axis] if side == 0 else scene.domain.size[axis] - rows[:, axis]).min()
            if kind == "slip" and depth < reach:
                holding.add(wall)
    return tuple(WALLS[wall] for wall in sorted(holding))
