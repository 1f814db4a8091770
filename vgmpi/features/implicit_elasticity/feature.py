"""Implicit elasticity of solids: the grid holds their short waves back, so that steps are long.

See docs/explanation/implicit-elasticity.md.
"""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import model_validator

from vgmpi.materials.couplings.interaction import CONTACT, DRAG
from vgmpi.materials.material import Quantity, field_error
from vgmpi.runtime.config.schema import StrictModel
from vgmpi.scene.scene_feature import SceneFeature


class AccuracyKeys(StrictModel):
    """Keys that the implicit elasticity adds to [accuracy]."""

    elasticity: Literal["explicit", "implicit"] | None = None
    """how the stress of solids acts, by default as the pressure of liquids is found. explicit: on
    each node alone; their waves bound the step. implicit: on all nodes of a solid together, by a
    system of equations of the grid that slows the waves that are shorter than some steps' way. It
    needs transfer = "apic", which is then the default, or "pic\""""
    elastic_courant_number: Annotated[float, Quantity("", gt=0, le=10)] = 3.0
    """cells that a wave of a solid goes in a step, at most, with elasticity = "implicit\""""

    @model_validator(mode="after")
    def _check_elasticity(self) -> Self:
        if self.elasticity != "implicit":
            return self
        # what other transfers restore of waves that are slowed makes them grow
        if "transfer" not in self.model_fields_set:
            object.__setattr__(self, "transfer", "apic")
        elif getattr(self, "transfer", "apic") not in ("apic", "pic"):
            message = "elasticity = 'implicit' needs transfer = 'apic' or 'pic'"
            raise field_error(self, "transfer", message)
        return self


class ImplicitElasticity(SceneFeature):
    """Implicit elasticity in the tables of a scene."""

    name, title = "implicit_elasticity", "implicit elasticity"
    section_keys = {"accuracy": AccuracyKeys}
    missing_engines = ("cuda", "numpy")

    def obstacles(self, scene: Any) -> list[tuple[tuple, str]]:
        """Return what a scene whose solids have an implicit elasticity cannot have.

        Args:
            scene: See `SceneFeature.obstacles`.
        """
        has_solids = any(m.family != "fluid" for m in scene.used_materials.values())
        return list(_unknown_parts(scene)) if has_solids and _is_implicit(scene) else []

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with groups whose waves the grid slows.

        Args:
            draft, prepared: See `SceneFeature.plan`.

        Raises:
            SceneError: The scene has what an implicit elasticity does not know.
        """
        if not _is_implicit(draft.scene):
            return None, draft
        if all(group.is_liquid or group.is_carried for group in draft.groups):
            return None, draft
        if wrong := self.obstacles(draft.scene):
            raise draft.scene.error(wrong)
        from .plan import plan_implicit_elasticity

        return plan_implicit_elasticity(draft)


def _is_implicit(scene: Any) -> bool:
    """Return whether solids of a scene have an implicit elasticity."""
    return bool((scene.accuracy.elasticity or scene.accuracy.pressure) == "implicit")


def _unknown_parts(scene: Any) -> Iterator[tuple[tuple, str]]:
    """Yield (path of a key, message) of all that an implicit elasticity does not know."""
    message = "accuracy.elasticity = 'implicit' is not for"
    rules = {CONTACT} if scene.accuracy.pressure == "explicit" else {CONTACT, DRAG}
    for k, coupling in enumerate(scene.coupling):
        if coupling.rule not in rules:
            yield ("coupling", k, "kind"), f"{message} couplings of kind {coupling.kind!r}"
    for k, obj in enumerate(scene.object):
        if obj.motion and not obj.collider:
            yield ("object", k, "motion"), f"{message} bodies of particles that are moved"
    held_at_rest = {obj.name for obj in scene.object if obj.collider and not obj.motion}
    for k, obj in enumerate(scene.object):
        for part in obj.pinned:
            if part.motion or part.to not in ("world", *held_at_rest):
                yield ("object", k, "pinned"), f"{message} pinned parts that move"


FEATURE = ImplicitElasticity()
