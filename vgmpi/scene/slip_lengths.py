"""Slip of viscous liquids on colliders, rigid bodies and solids: what a scene may ask for."""

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
    if scenery and raw.get("collider") is not True:
        return [(("slip_length",), "is only for bodies of solids and scenery with collider = true")]
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
        key, own = ("object", k, "slip_length"), materials.get(obj.material)
        if own is not None and own.family != "solid":
            message = f"is only for bodies of solids and colliders: kind {own.kind!r} is none"
            errors.append((key, message))
            continue
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
        elif own is not None and not obj.rigid:
            errors += _friction_besides(key, obj.material, materials, couplings)
    return errors


def _friction_besides(
    key: tuple, solid: str, materials: dict, couplings: list
) -> list[tuple[tuple, str]]:
    """Return (path, message) if a coupling names the friction of a viscous liquid on a solid."""
    for coupling in couplings:
        if coupling is None or solid not in coupling.between or not coupling.friction:
            continue
        for liquid in coupling.between:
            if liquid != solid and dynamic_viscosity(materials[liquid]):
                names = f"{liquid!r} and {solid!r}"
                return [(key, f"the coupling of {names} has friction: give one of the two")]
    return []
