"""Warnings about settings that are allowed and rarely meant."""

import logging

from vgmpi.scene.scene import Scene

log = logging.getLogger("vgmpi")


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
