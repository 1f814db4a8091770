"""Regions of a body: which of its particles consist of another material."""

import logging
from dataclasses import replace
from typing import Any

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene

from .built_object import BuiltObject
from .memory_estimate import spacing_of
from .shape_sdf import contains

log = logging.getLogger("vgmpi")


def sort_by_region(scene: Scene, obj: Object, piece: BuiltObject) -> BuiltObject:
    """Return the object with its particles in the order of its regions, those of none first.

    An object without regions is returned as it is. Where regions overlap, the later one counts.
    """
    if not obj.region:
        return piece
    x, spacing = piece.cloud.x, spacing_of(scene, obj)
    region = np.full(len(x), -1)
    for k, shape in enumerate(obj.region):
        region[contains(shape, x, spacing)] = k
    cloud = _with_region_colors(obj, piece.cloud, region)
    order = np.argsort(region, kind="stable")
    counts = np.bincount(region + 1, minlength=len(obj.region) + 1)[1:]
    return replace(
        replace(piece, cloud=cloud).select(order), region_counts=tuple(counts.tolist())
    )  # fmt: skip


def _with_region_colors(obj: Object, cloud: GaussianCloud, region: np.ndarray) -> GaussianCloud:
    """Return the Gaussians with the colors of their regions `region` (n,), -1 for none."""
    sh = cloud.sh.copy()
    for k, part in enumerate(obj.region or ()):
        if part.color is not None:
            mask = region == k
            sh[mask, 0] = dc_from_rgb(np.outer(cloud.shades[mask], part.color))
    return replace(cloud, sh=sh)


def validate_region_particles(
    scene: Scene, obj: Object, piece: BuiltObject
) -> list[tuple[tuple, str]]:
    """Return (path, message) for regions without a particle; warn of those that hold all.

    Args:
        scene: The scene.
        obj: Object of the scene.
        piece: Its particles in the order of its regions.
    """
    errors: list[tuple[tuple, str]] = []
    for k, count in enumerate(piece.region_counts):
        region: Any = obj.region[k] if obj.region else None
        if count == len(piece.cloud):
            log.warning(
                "'%s': region %d holds all its particles: material '%s' makes up nothing of it",
                obj.name, k, obj.material,
            )  # fmt: skip
        if count:
            continue
        message = f"holds no particle of {obj.name} at the start"
        if contains(region, piece.cloud.x, spacing_of(scene, obj)).any():
            message = "holds no particle: later regions take all of them"
        errors.append((("region", k, region.form), message))
    return errors


def region_entries(
    scene: Scene, obj: Object, piece: BuiltObject, first: int
) -> list[dict[str, Any]]:
    """Return the entries of an object's regions in output files, as JSON values.

    Args:
        scene: The scene.
        obj: Object of the scene.
        piece: Its particles in the order of its regions.
        first: Id of its first particle.
    """
    first += len(piece.cloud) - sum(piece.region_counts)
    entries = []
    for region, count in zip(obj.region or (), piece.region_counts, strict=True):
        density = scene.material[region.material].bulk_density
        entries.append(
            {"material": region.material, "density": density, "first_row": first,
             "row_count": count}
        )  # fmt: skip
        first += count
    return entries


def particle_masses(scene: Scene, obj: Object, piece: BuiltObject) -> np.ndarray:
    """Return the masses (n,) [kg] of the particles of a body."""
    counts = (len(piece.cloud) - sum(piece.region_counts), *piece.region_counts)
    names = (obj.material, *(region.material for region in obj.region or ()))
    densities = [scene.material[name].bulk_density for name in names if name is not None]
    return np.repeat(densities, counts) * piece.volume


def densities_of(objects: list[dict], owner: np.ndarray) -> np.ndarray:
    """Return the bulk densities (n,) [kg/m3] of all particles, 0 for those without a material.

    Args:
        objects: Entries of the objects and particle sources.
        owner: Object of each particle in the order of their ids, shape (n,).
    """
    densities = np.array([entry["density"] or 0.0 for entry in objects])[owner]
    for entry in objects:
        for part in entry.get("regions", ()):
            first = part["first_row"]
            densities[first : first + part["row_count"]] = part["density"]
    return densities


def index_runs(chosen: np.ndarray) -> np.ndarray:
    """Return first and last index (m, 2) of each run of true values of `chosen` (n,)."""
    edges = np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]]))
    return np.stack([np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1], 1)
