"""Slip of viscous liquids on colliders and rigid bodies: what a scene may ask for."""

import math
from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT


def dynamic_viscosity(material: Any) -> float:
    """Return the viscosity of a liquid [Pa s], infinite if it depends on the shear rate.

    Materials other than viscous liquids have none: 0.

    Args:
        material: Material of a scene.
    """
    if material.family != "fluid":
        return 0.0
    return getattr(material, "viscosity", math.inf)


def validate_slip_length(raw: dict, scenery: bool) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys of an object that do not go together with `slip_length`.

    Args:
        raw: Table of the object as read.
        scenery: Whether it is scenery.
    """
    if "slip_length" not in raw:
        return []
    if not (raw.get("collider") is True if scenery else raw.get("rigid") is True):
        return [(("slip_length",), "is only for scenery with collider = true and rigid bodies")]
    if "friction" in raw:
        message = "friction and slip_length given at once: give one"
        return [(("slip_length",), message)]
    return []


def validate_slip_lengths(
    objects: list, materials: dict, couplings: list, accuracy: Any
) -> list[tuple[tuple, str]]:
    """Return (path, message) for what a scene with slip lengths cannot have.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        couplings: Couplings of its materials, None in place of invalid ones.
        accuracy: Table `accuracy`, or None.
    """
    errors: list[tuple[tuple, str]] = []
    viscous = [dynamic_viscosity(material) for material in materials.values() if material]
    for k, obj in enumerate(objects):
        if obj.slip_length is None:
            continue
        key = "object", k, "slip_length"
        if not any(viscous) and None not in materials.values():
            errors.append((key, "needs a liquid with viscosity; the scene has none"))
        elif obj.slip_length > 0.0 and math.inf in viscous:
            message = "must be 0 for kind 'paste': its viscosity depends on the shear rate"
            errors.append((key, message))
        elif accuracy is not None and accuracy.keeps:
            errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
        elif any(coupling is not None and coupling.rule != CONTACT for coupling in couplings):
            message = "is not for scenes in which materials mix or flow through sand"
            errors.append((key, message))
    return errors
