"""Thin walls: colliders whose two sides are kept apart, however thin they are.

See docs/explanation/contact.md, thin walls.
"""

from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.runtime.config.schema import StrictModel, Switch
from vgmpi.scene.scene_feature import Errors, SceneFeature


class ObjectKeys(StrictModel):
    """Keys that thin walls add to [[object]]."""

    thin: Switch = False
    """colliders only: a shell, up to three cells thick, both sides of which may be wet, such as a
    cup or a plate. What is on one side neither passes to the other nor feels it. Walls thinner than
    half a cell act as half a cell thick, and so do the faces of an open mesh"""


class ThinWalls(SceneFeature):
    """Thin walls in the tables of a scene."""

    name = "thin_walls"
    title = "thin walls"
    object_keys = ObjectKeys
    missing_engines = ("cuda",)
    hints = {
        "open mesh": "; thin = true makes it a wall",
        "thin collider": ", unless object.thin = true",
    }

    def check_object(self, raw: dict, is_scenery: bool) -> Errors:
        """Return the errors of keys of an object that do not go together with `thin`."""
        errors: Errors = []
        if "points" in raw and raw.get("thin", "off") not in (False, "off"):
            errors.append((("thin",), "is not for objects made of points"))
        if raw.get("thin") is True and not (is_scenery and raw.get("collider") is True):
            errors.append((("thin",), "is only for scenery with collider = true"))
        return errors

    def check_scene(self, objects: list, materials: dict, couplings: list, accuracy: Any) -> Errors:
        """Return what a scene with thin walls cannot have.

        Args:
            objects, materials, couplings, accuracy: See `SceneFeature.check_scene`.
        """
        thin = [k for k, obj in enumerate(objects) if obj.thin]
        if not thin:
            return []
        key, errors = ("object", thin[0], "thin"), []
        if accuracy is not None and accuracy.is_flip:
            errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
        if any(coupling is not None and coupling.rule != CONTACT for coupling in couplings):
            errors.append((key, "is not for scenes in which materials mix or flow through sand"))
        if any(obj.slip_length is not None for obj in objects):
            errors.append((key, "is not for scenes with object.slip_length"))
        if any(obj.rigid for obj in objects):
            errors.append((key, "is not for scenes with free rigid bodies"))
        return errors

    def takes_open_mesh(self, obj: Any) -> bool:
        """Return whether the faces of an open mesh are walls: those of a thin wall are."""
        return obj.thin

    def complete_collider(
        self, obj: Any, collider: Any, dx: float, size: tuple[float, float, float]
    ) -> Any:
        """Return the collider of an object with its two sides, if it is a thin wall.

        Args:
            obj, collider, dx, size: See `SceneFeature.complete_collider`.
        """
        if not obj.thin:
            return collider
        from .shells import with_shell  # it imports scipy: only scenes with thin walls wait

        return with_shell(collider, dx, size)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the sides, and the draft with those on back sides last.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not any(obj.thin for obj in draft.scene.object):
            return None, draft
        from .plan import plan_thin_walls

        return plan_thin_walls(draft)


FEATURE = ThinWalls()
