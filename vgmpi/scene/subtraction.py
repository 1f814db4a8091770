"""Objects that are cut out of a body of liquid, sand or snow at the start: the key `subtract`."""

from typing import Annotated, Any

from pydantic import BeforeValidator

from vgmpi.runtime.message_text import did_you_mean


def _checked(value: Any) -> Any:
    """Return true, the names of objects, or None; raise ValueError for anything else."""
    if isinstance(value, bool) or value is None:
        return value or None
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise ValueError("must be true, or a list of names of objects")
    if not names:
        raise ValueError("must name an object; leave the key out where nothing is cut out")
    return tuple(dict.fromkeys(names))


# true, names of objects, or None where nothing is cut out
Subtraction = Annotated[bool | tuple[str, ...] | None, BeforeValidator(_checked)]


def is_subtractable(obj: Any, materials: dict) -> bool:
    """Return whether an object can be cut out of others: no liquid, sand or snow gets into it.

    Args:
        obj: Object of the scene; a rigid body may already be the collider that represents it.
        materials: Materials by their names, None in place of invalid ones.
    """
    material = materials.get(obj.material)
    is_solid = obj.role == "body" and material is not None and material.family == "solid"
    return obj.collider or obj.rigid or is_solid


def subtracted_names(obj: Any, objects: Any, materials: dict) -> tuple[str, ...]:
    """Return the names of the objects that are cut out of an object, in the order of the scene.

    Args:
        obj: Object of the scene.
        objects: All objects of the scene.
        materials: Materials by their names.
    """
    if not obj.subtract:
        return ()
    return tuple(
        other.name
        for other in objects
        if other.name != obj.name
        and is_subtractable(other, materials)
        and (obj.subtract is True or other.name in obj.subtract)
    )


def validate_subtractions(
    objects: list, materials: dict, couplings: list, accuracy: Any
) -> list[tuple[tuple, str]]:
    """Return (path, message) for objects that cannot be cut out of others.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        couplings: Couplings of its materials, unused.
        accuracy: Table `accuracy`, unused.
    """
    errors: list[tuple[tuple, str]] = []
    by_name = {obj.name: obj for obj in objects}
    for k, obj in enumerate(objects):
        key = "object", k, "subtract"
        material = materials.get(obj.material)
        if obj.subtract is None or obj.rigid or obj.role != "body" or material is None:
            continue
        if material.family == "solid":
            message = "is for bodies of liquids, pastes, sand and snow; cut a solid by a shape"
            errors.append((key, f"{message}: shape = {{ difference = [...] }}"))
        elif obj.subtract is True:
            if not subtracted_names(obj, objects, materials):
                message = "there is nothing to cut out: no collider, rigid body or solid"
                errors.append((key, message))
        else:
            reasons = [_refusal(name, obj.name, by_name, materials) for name in obj.subtract]
            errors += [(key, reason) for reason in reasons if reason]
    return errors


def _refusal(name: str, own: str, by_name: dict, materials: dict) -> str:
    """Return why an object cannot be cut out of another one, or an empty text."""
    if name == own:
        return f"'{name}' cannot be cut out of itself"
    if name not in by_name:
        hint = did_you_mean(name, by_name)
        return f"there is no object '{name}'{hint}; known: {', '.join(by_name)}"
    if is_subtractable(by_name[name], materials):
        return ""
    if by_name[name].role == "scenery":
        return f"'{name}' is scenery without collider = true: what flows passes through it"
    return (
        f"'{name}' is no collider, rigid body or solid: give each body a space of its own by"
        " shape = { difference = [...] }"
    )
