"""Regions of a body: parts that consist of another material of the same kind."""

from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.material import unknown_material
from vgmpi.runtime.config.schema import Color

from .shapes import Shape, validate_shape


class Region(Shape):
    """Part of a body that consists of another material of the same kind: exactly one shape (domain
    coordinates) and `material`. Its particles are those inside the shape at the start, wherever
    they move later. Where regions overlap, the later one counts. All parts share one velocity
    field: they are bonded to each other.
    """

    material: str
    """name of a [material.*] table of the same kind as that of the object"""
    color: Color | None = None
    """objects made of a shape only: color of this part; default: that of the shape"""


def validate_regions(raw: dict) -> list[tuple[tuple, str]]:
    """Return (path, message) for errors of the regions of one object besides their values.

    Args:
        raw: Table of the object as read.
    """
    if "region" not in raw:
        return []
    errors: list[tuple[tuple, str]] = []
    if raw.get("initial_pressure") == "hydrostatic":
        message = 'is not for a body with initial_pressure = "hydrostatic", which has one density'
        errors.append((("region",), message))
    regions = raw["region"] if isinstance(raw["region"], list) else [raw["region"]]
    for k, region in enumerate(regions):
        errors += validate_shape(region, ("region", k))
        if isinstance(region, dict) and "color" in region and "shape" not in raw:
            errors.append((("region", k, "color"), "is only for objects made of a shape"))
    return errors


def validate_region_kinds(
    objects: list, materials: dict, couplings: list, accuracy: Any
) -> list[tuple[tuple, str]]:
    """Return (path, message) for materials that the regions of a scene cannot have.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        couplings: Couplings of its materials, None in place of invalid ones.
        accuracy: Table `accuracy`, or None.
    """
    errors: list[tuple[tuple, str]] = []
    shares = {name for c in couplings if c is not None and c.rule != CONTACT for name in c.between}
    for k, obj in enumerate(objects):
        body = materials.get(obj.material)
        for index, region in enumerate(obj.region or ()):
            key, own = ("object", k, "region", index, "material"), materials.get(region.material)
            if region.material not in materials:
                errors.append((key, unknown_material(region.material, materials)))
            elif own is not None and body is not None and own.kind != body.kind:
                message = (
                    f"must be of kind {body.kind!r}, as {obj.material!r} of the object is;"
                    f" {region.material!r} is of kind {own.kind!r}"
                )
                errors.append((key, message))
            elif shares & {region.material, obj.material}:
                name = min(shares & {region.material, obj.material})
                message = f"{name!r} mixes or flows through sand by a coupling: no body of it"
                errors.append((key, f"{message} has regions"))
    return errors
