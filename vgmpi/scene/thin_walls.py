"""Thin walls: colliders whose two sides are kept apart, however thin they are."""

from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT


def validate_thin(raw: dict, scenery: bool) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys of an object that do not go together with `thin`.

    Args:
        raw: Table of the object as read.
        scenery: Whether it is scenery.
    """
    if raw.get("thin") is not True or (scenery and raw.get("collider") is True):
        return []
    return [(("thin",), "is only for scenery with collider = true")]


def validate_thin_scene(
    objects: list, materials: dict, couplings: list, accuracy: Any
) -> list[tuple[tuple, str]]:
    """Return (path, message) for what a scene with thin walls cannot have.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        couplings: Couplings of its materials, None in place of invalid ones.
        accuracy: Table `accuracy`, or None.
    """
    thin = [k for k, obj in enumerate(objects) if obj.thin]
    if not thin:
        return []
    key, errors = ("object", thin[0], "thin"), []
    if accuracy is not None and accuracy.keeps:
        errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
    if any(coupling is not None and coupling.rule != CONTACT for coupling in couplings):
        errors.append((key, "is not for scenes in which materials mix or flow through sand"))
    if any(obj.slip_length is not None for obj in objects):
        errors.append((key, "is not for scenes with object.slip_length"))
    if any(obj.rigid for obj in objects):
        errors.append((key, "is not for scenes with free rigid bodies"))
    return errors
