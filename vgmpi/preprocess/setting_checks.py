"""Warnings about settings that are allowed and rarely meant."""

import logging

import numpy as np

from vgmpi.scene.scene import Scene

from .object_builder import BuiltObject

log = logging.getLogger("vgmpi")

MIN_DOMAIN_FRACTION = 0.1  # [-] of the domain's edges, below which all objects together are small


def warn_of_locking(scene: Scene) -> None:
    """Warn of nearly incompressible materials: linear shapes in a cell lock when they bend."""
    for name, material in scene.material.items():
        ratio = getattr(material, "poisson_ratio", 0.0)
        if ratio > 0.45:
            log.warning("material '%s': poisson_ratio = %g is above 0.45: it will bend too stiffly",
                        name, ratio)  # fmt: skip


def report_flip_ratio(scene: Scene) -> None:
    """Log that a FLIP ratio per step makes losses depend on the time step."""
    if scene.accuracy.keeps and scene.accuracy.flip_ratio is not None:
        log.info(
            "accuracy.flip_ratio = %g is kept in each step: the shorter the step, the more is lost;"
            " accuracy.flip_decay_time is a time",
            scene.accuracy.flip_ratio,
        )


def warn_of_small_objects(scene: Scene, pieces: list[BuiltObject]) -> None:
    """Warn if all objects fill less than a thousandth of the domain, as if a unit were missing.

    Args:
        scene: The scene.
        pieces: Its objects.
    """
    if scene.inlet or any(obj.motion is not None for obj in scene.object):
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
