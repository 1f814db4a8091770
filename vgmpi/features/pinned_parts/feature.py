"""Pinned parts of elastic bodies: regions that a collider, a rigid body or the world holds.

Their particles have groups of their own, are not on the grid, and move with what holds them. Nodes
of the body next to a part take its velocity (coupling.py). See docs/explanation/rigid-bodies.md.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from vgmpi.runtime.config.schema import Quantity, StrictModel, as_list
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.scene.rigid_motion import Motion, validate_motion
from vgmpi.scene.scene_feature import Errors, InitialParticles, SceneFeature
from vgmpi.scene.shapes import Shape, validate_shape

WORLD = "world"
# keys of bodies that cannot have pinned parts: nothing of them moves freely for a time
EXCLUDED_KEYS = ("rigid", "motion", "release_time", "volume_fraction", "volume_fraction_profile")


class PinnedPart(Shape):
    """Pinned part of a solid body: exactly one of the keys of `shape` that make a solid, `box` for
    example, in coordinates of the domain at the start, and these. It may hold particles of several
    regions.
    """

    to: str = WORLD
    """what holds it: "world", the name of scenery with collider = true, moving or at rest, or that
    of a body with rigid = true"""
    motion: Motion | None = None
    """for to = "world": prescribed motion of the part. Default: it is at rest"""
    release_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """for to = "world": time at which the part lets go. It deforms from then on, and begins with
    the velocity of its motion. Default: never"""


class ObjectKeys(StrictModel):
    """Keys that pinned parts add to [[object]]."""

    pinned: Annotated[tuple[PinnedPart, ...], BeforeValidator(as_list)] = ()
    """bodies of solids only: a part that something holds, { box, to } for example, or a list of
    them. The part does not deform and moves with what holds it; the rest is attached to it"""


def validate_pinned(raw: dict, scenery: bool) -> Errors:
    """Return (path, message) for errors of the pinned parts of an object as read.

    Args:
        raw: Table of the object.
        scenery: Whether it is scenery.
    """
    if "pinned" not in raw:
        return []
    if scenery:
        return [(("pinned",), "is not for scenery: it has no mass and does not move")]
    errors: Errors = []
    for key in EXCLUDED_KEYS:
        if raw.get(key) not in (None, False):
            errors.append((("pinned",), f"{key} and pinned given at once: give one"))
    tables = raw["pinned"]
    single = isinstance(tables, dict)
    for k, table in enumerate([tables] if single else tables if isinstance(tables, list) else []):
        if not isinstance(table, dict):
            continue
        path: tuple = ("pinned",) if single else ("pinned", k)
        errors += validate_shape({key: table[key] for key in table if key != "to"}, path)
        errors += validate_motion(table.get("motion"), (*path, "motion"))
        if "color" in table:
            errors.append(((*path, "color"), "is not for pinned parts"))
        if table.get("to", WORLD) == WORLD:
            continue
        reasons = {"motion": "the part moves with what holds it", "release_time": "it lets go"}
        for key, reason in reasons.items():
            if key in table:
                errors.append(((*path, key), f'is only for to = "{WORLD}": {reason}'))
    if isinstance(tables, list) and not tables:
        errors.append((("pinned",), "has no part"))
    return errors


def validate_pinned_parts(objects: list, materials: dict, accuracy: Any) -> Errors:
    """Return (path, message) for what a scene with pinned parts cannot have.

    Args:
        objects: Objects of the scene.
        materials: Materials by their names, None in place of invalid ones.
        accuracy: Table `accuracy`, or None.
    """
    errors: Errors = []
    by_name = {obj.name: obj for obj in objects}
    for k, obj in enumerate(objects):
        if not obj.pinned:
            continue
        key = "object", k, "pinned"
        material = materials.get(obj.material)
        if material is not None and material.family != "solid":
            message = f"is only for solids; the material is of kind {material.kind!r}"
            errors.append((key, message))
        elif accuracy is not None and accuracy.is_flip:
            errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
        for number, part in enumerate(obj.pinned):
            if message := _validate_holder(part.to, obj.name, by_name):
                errors.append(((*key, number, "to"), message))
    return errors


def _validate_holder(name: str, own: str, objects: dict) -> str:
    """Return why an object cannot hold a part of another one, or an empty text.

    Args:
        name: Name of what holds the part.
        own: Name of the object that has the part.
        objects: Objects of the scene by name.
    """
    if name == WORLD:
        return ""
    if name == own:
        return f"'{name}' cannot hold itself"
    holder = objects.get(name)
    if holder is None:
        hint = f"{did_you_mean(name, [*objects, WORLD])}; known: {', '.join([WORLD, *objects])}"
        return f"there is no object '{name}'{hint}"
    if not holder.rigid and not holder.collider:
        return (
            f"'{name}' holds nothing: scenery with collider = true does, and a body with rigid ="
            " true"
        )
    return ""


class PinnedParts(SceneFeature):
    """Pinned parts in the tables of a scene."""

    name, title = "pinned_parts", "pinned parts"
    force_source = "a body that is pinned to the world"
    object_keys, sections, makes_particles = ObjectKeys, {"pinned": PinnedPart}, True
    missing_engines = ("cuda",)

    def check_object(self, raw: dict, is_scenery: bool) -> Errors:
        """Return the errors of one object as read."""
        return validate_pinned(raw, is_scenery)

    def check_scene(self, objects: list, materials: dict, couplings: list, accuracy: Any) -> Errors:
        """Return what a scene with pinned parts cannot have.

        Args:
            objects, materials, couplings, accuracy: See `SceneFeature.check_scene`.
        """
        return validate_pinned_parts(objects, materials, accuracy)

    def has_force(self, obj: Any) -> bool:
        """Return whether the world holds a part of a body."""
        return any(part.to == WORLD for part in obj.pinned)

    def may_overlap(self, obj: Any) -> bool:
        """Return whether a body has a part that may lie in what holds it."""
        return bool(obj.pinned)

    def hangs(self, obj: Any, lowest: np.ndarray, spacing: float) -> bool:
        """Return whether a body is pinned, but not at its lowest point.

        Args:
            obj, lowest, spacing: See `SceneFeature.hangs`.
        """
        from vgmpi.preprocess.shape_sdf import contains  # it compiles

        parts = [contains(part, lowest, spacing).any() for part in obj.pinned]
        return bool(parts) and not any(parts)

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the pinned parts with their particles, or None without any.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        if not any(obj.pinned for obj in scene.object):
            return None
        from .regions import resolve_pinned_parts  # it compiles

        return tuple(resolve_pinned_parts(scene, particles, colliders)) or None

    def adjust_colliders(self, colliders: list, prepared: Any) -> list:
        """Return the colliders; free rigid bodies include the masses that they hold.

        Args:
            colliders, prepared: See `SceneFeature.adjust_colliders`.
        """
        from .regions import with_pinned_masses

        return with_pinned_masses(colliders, prepared)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the parts, and the draft with their groups last.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if prepared is None:
            return None, draft
        from .plan import plan_pinned_parts

        plan, groups = plan_pinned_parts(draft.groups, draft.group_of, prepared)
        return plan, draft._replace(groups=groups)


FEATURE = PinnedParts()
