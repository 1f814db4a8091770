"""Implicit viscosity of liquids: a system of equations of the nodes, so that it bounds no step.

See docs/explanation/implicit-viscosity.md.
"""

from collections.abc import Iterator
from typing import Any, Literal

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.runtime.config.schema import StrictModel
from vgmpi.scene.scene_feature import SceneFeature, features
from vgmpi.scene.step_estimates import motion_rate, viscous_rate

# [-] Least ratio of the step without the bound of an explicit viscosity to that with it. Beside an
# implicit pressure, a step takes 2.2 times as long (docs/explanation/implicit-viscosity.md).
MIN_GAIN = 2.5


class AccuracyKeys(StrictModel):
    """Keys that the implicit viscosity adds to [accuracy]."""

    viscosity: Literal["explicit", "implicit"] | None = None
    """how the viscosity of liquids acts. explicit: by the stress of each particle; its diffusion
    bounds the step. implicit: by a system of equations of the grid that bounds no step: for scenes
    of Newtonian liquids between walls and colliders. By default it is implicit in those with an
    implicit pressure whose steps become 2.5 times as long"""


class ImplicitViscosity(SceneFeature):
    """Implicit viscosity in the tables of a scene."""

    name, title = "implicit_viscosity", "implicit viscosity"
    section_keys = {"accuracy": AccuracyKeys}
    chosen_keys = {"viscosity": "explicit"}
    missing_engines = ("cuda", "numpy")
    precedes_copies = True

    def choose_defaults(self, scene: Any) -> Any:
        """Return a scene that names no viscosity with the better one.

        Args:
            scene: See `SceneFeature.choose_defaults`.
        """
        if scene.accuracy.viscosity is not None:
            return scene
        explicit, implicit = (
            scene.with_defaults({"viscosity": name}) for name in ("explicit", "implicit")
        )
        if not scene.is_free_of_waves:
            return explicit
        gain = viscous_rate(scene) / motion_rate(scene, scene.accuracy.elastic_courant_number)
        if gain < MIN_GAIN or obstacles(implicit):
            return explicit
        reason = f"implicit: steps are {gain:.2g} times as long as explicit ones"
        return implicit.with_choice("viscosity", reason)

    def obstacles(self, scene: Any) -> list[tuple[tuple, str]]:
        """Return what a scene with an implicit viscosity cannot have.

        Args:
            scene: See `SceneFeature.obstacles`.
        """
        return obstacles(scene) if scene.accuracy.viscosity == "implicit" else []

    def advice_lines(self, scene: Any, plan: Any) -> list[str]:
        """Return a line of the plan report on a scene of an explicit pressure that may want it.

        Args:
            scene, plan: See `SceneFeature.advice_lines`.
        """
        is_named = "viscosity" in scene.accuracy.model_fields_set
        if is_named or scene.is_free_of_waves or obstacles(scene):
            return []
        from .plan import recommend_implicit_viscosity

        return recommend_implicit_viscosity(scene, plan)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with groups whose viscosity the grid has.

        Args:
            draft, prepared: See `SceneFeature.plan`.

        Raises:
            SceneError: The scene has what an implicit viscosity does not know.
        """
        if draft.scene.accuracy.viscosity == "explicit":
            return None, draft
        if wrong := obstacles(draft.scene):
            raise draft.scene.error(wrong)
        from .plan import plan_implicit_viscosity

        return plan_implicit_viscosity(draft)


def obstacles(scene: Any) -> list[tuple[tuple, str]]:
    """Return (path of a key, message) of all that an implicit viscosity does not know."""
    unknown = [*_materials(scene), *_bodies(scene), *_tables(scene)]
    return [(path, f"accuracy.viscosity = 'implicit' is not for {what}") for path, what in unknown]


def _materials(scene: Any) -> Iterator[tuple[tuple, str]]:
    """Yield (path of a key, noun phrase) of materials and couplings."""
    names = [name for entity in scene.entities for name in scene.materials_of(entity)]
    for name in dict.fromkeys(names):
        if scene.material[name].kind != "fluid":
            yield ("material", name, "kind"), "materials other than Newtonian liquids"
    for k, coupling in enumerate(scene.coupling):
        if coupling.rule != CONTACT:
            yield ("coupling", k, "kind"), "liquids that mix"
    in_phase: dict[str, set] = {}
    for entity in scene.entities:
        for material in (scene.material[name] for name in scene.materials_of(entity)):
            numbers = material.bulk_density, material.kinematic_viscosity
            in_phase.setdefault(scene.phase_of(entity), set()).add(numbers)
    if any(len(numbers) > 1 for numbers in in_phase.values()):
        yield ("accuracy", "viscosity"), "liquids of several densities or viscosities in one phase"


def _bodies(scene: Any) -> Iterator[tuple[tuple, str]]:
    """Yield (path of a key, noun phrase) of bodies and colliders."""
    for k, obj in enumerate(scene.object):
        own = [key for feature in features() for key in feature.keys_of(obj)]
        # an implicit pressure is all that acts between a liquid and free bodies
        is_pushed = obj.rigid and not scene.is_free_of_waves
        values = {"rigid": is_pushed, "motion": obj.motion and not obj.collider}
        for key in dict.fromkeys([key for key, value in values.items() if value] + own):
            if key != "slip_length":
                yield ("object", k, key), "bodies that are held or moved, and thin walls"
            elif getattr(obj, key) > 0:
                yield ("object", k, key), "slip lengths other than 0"
            elif obj.rigid:
                yield ("object", k, key), "slip lengths of free bodies"
        if obj.friction:
            yield ("object", k, "friction"), "colliders with friction"


def _tables(scene: Any) -> Iterator[tuple[tuple, str]]:
    """Yield (path of a key, noun phrase) of tables of features, probes, walls and output."""
    for feature in features():
        for name in () if feature.suits_implicit_pressure else feature.lists:
            if scene.lists[name]:
                yield (name, 0), feature.title
    for k, probe in enumerate(scene.probe):
        if probe.measures_reaction:
            key = "wall" if probe.wall else "collider"
            yield ("probe", k, key), "probes of forces on a wall or collider"
    if any(friction for _, friction in scene.domain.walls):
        yield ("domain", "boundary"), "walls with friction"
    if "stress" in scene.output.fields:
        yield ("output", "fields"), "the field stress, which is that of particles"


FEATURE = ImplicitViscosity()
