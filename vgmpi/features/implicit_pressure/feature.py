"""Implicit pressure of liquids: a system of equations of the grid finds it, so that steps are long.

Only the motion bounds the step. See docs/explanation/implicit-pressure.md.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import model_validator

from vgmpi.materials.couplings.interaction import CONTACT, DRAG, MIXING
from vgmpi.materials.material import field_error
from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.scene.scene import miscible_materials
from vgmpi.scene.scene_feature import SceneFeature, features
from vgmpi.scene.step_estimates import motion_rate, viscous_rate

MAX_CONTRAST = 10_000.0  # [-] of densities; beyond it runs were seen to blow up
MAX_FREE_BODIES = 64  # the work of a step grows with the cube of their number
HELD_BODIES = "bodies of particles that are held or moved, and colliders with friction"
# [-] Least ratio of the implicit step to the explicit one, in a liquid alone and with colliders or
# free bodies. By the table of whole scenes in docs/explanation/implicit-pressure.md, an implicit
# step takes 1.7 times as long in two_liquids, 2.8 and 3.2 times in water_wheel and driftwood.
MIN_GAIN, MIN_GAIN_BESIDE_BODIES = 2.5, 3.5
# values of other keys of [accuracy] that an implicit pressure needs
COMPANIONS = {"transfer": "apic", "volume_correction": "none", "dilatation": "particles"}


class AccuracyKeys(StrictModel):
    """Keys that the implicit pressure adds to [accuracy]."""

    pressure: Literal["explicit", "implicit"] | None = None
    """how the pressure of liquids is found. explicit: from the volume of each particle; its waves
    bound the step. implicit: by a system of equations of the grid, so that only the motion bounds
    the step: for scenes of liquids, with colliders without friction and free rigid bodies, to
    which they may stick, solids (see elasticity), and sands through which they flow. It needs
    transfer = "apic" and volume_correction = "none", which are then the defaults. By default it is
    implicit in scenes that can have it, without deformable solids, sand and snow, whose steps
    become 2.5 times as long, 3.5 times with colliders or free bodies; --plan prints the choice and
    its reason"""

    @model_validator(mode="after")
    def _check_pressure(self) -> Self:
        for key, value in COMPANIONS.items() if self.pressure == "implicit" else ():
            if key in self.model_fields_set and getattr(self, key) != value:
                message = f"pressure = 'implicit' needs {key} = '{value}'"
                raise field_error(self, key, message)
            object.__setattr__(self, key, value)
        return self


class DomainKeys(StrictModel):
    """Keys that the implicit pressure adds to [domain]."""

    ambient_pressure: Annotated[float, Quantity("Pa", ge=0)] | None = None
    """pressure of the air, above that of a vacuum, with an implicit pressure: a liquid bears that
    much suction, anywhere, and then opens; air at sea level has 101325. Default: a liquid bears
    any suction, but for none on colliders and free bodies without slip_length"""


class ImplicitPressure(SceneFeature):
    """Implicit pressure in the tables of a scene."""

    name, title = "implicit_pressure", "implicit pressure"
    section_keys = {"accuracy": AccuracyKeys, "domain": DomainKeys}
    chosen_keys = {"pressure": "explicit"}
    missing_engines = ("cuda", "numpy")

    def removes_wave_bound(self, scene: Any) -> bool:
        """Return whether the grid finds the pressure of the scene's liquid."""
        return bool(scene.accuracy.pressure == "implicit")

    def choose_defaults(self, scene: Any) -> Any:
        """Return a scene that names no pressure with the better one.

        Args:
            scene: See `SceneFeature.choose_defaults`.
        """
        if scene.accuracy.pressure is not None:
            return scene
        explicit = scene.with_defaults({"pressure": "explicit"})
        implicit = scene.with_defaults({"pressure": "implicit", **COMPANIONS})
        return choose_pressure(scene, explicit, implicit)

    def obstacles(self, scene: Any) -> list[tuple[tuple, str]]:
        """Return what a scene with an implicit pressure cannot have.

        Args:
            scene: See `SceneFeature.obstacles`.
        """
        return find_obstacles(scene) if self.removes_wave_bound(scene) else []

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with groups whose pressure the grid finds.

        Args:
            draft, prepared: See `SceneFeature.plan`.

        Raises:
            SceneError: The scene has what an implicit pressure does not know.
        """
        if not self.removes_wave_bound(draft.scene):
            if draft.scene.domain.ambient_pressure is not None:
                message = "needs accuracy.pressure = 'implicit'; else see material.*.tension"
                raise draft.scene.error([(("domain", "ambient_pressure"), message)])
            return None, draft
        if wrong := self.obstacles(draft.scene):
            raise draft.scene.error(wrong)
        from .plan import plan_implicit_pressure

        return plan_implicit_pressure(draft)


def choose_pressure(scene: Any, explicit: Any, implicit: Any) -> Any:
    """Return the better one of two scenes, with a line on why.

    It depends on nothing but the scene: not on ranks, threads, the engine or the machine.

    Args:
        scene: The scene, which names no pressure.
        explicit, implicit: The same with either pressure.
    """
    families = {material.family for material in scene.used_materials.values()}
    if "fluid" not in families:
        return explicit
    for feature in reversed(features()):
        implicit = feature.choose_defaults(implicit)
    if scene.domain.ambient_pressure is not None:
        return implicit.with_choice("pressure", "implicit: domain.ambient_pressure asks for it")
    gain = _expected_rate(explicit) / _expected_rate(implicit)
    has_bodies = any(obj.collider or obj.rigid for obj in scene.object)
    min_gain = MIN_GAIN_BESIDE_BODIES if has_bodies else MIN_GAIN
    longer = f"{gain:.2g} times as long"
    if gain < min_gain:
        reason = f"explicit: implicit steps are {longer}, and pay from {min_gain:g} times on"
        return explicit.with_choice("pressure", reason)
    if obstacle := _first_obstacle(scene, implicit):
        reason = f"explicit: implicit steps would be {longer}, but {obstacle}"
        return explicit.with_choice("pressure", reason)
    reason = f"implicit: steps are {longer} as explicit ones"
    return implicit.with_choice("pressure", reason)


def _expected_rate(scene: Any) -> float:
    """Return the 1 / dt [1/s] that is expected of a run of a scene."""
    accuracy = scene.accuracy
    rate = motion_rate(scene, accuracy.elastic_courant_number)
    return rate if accuracy.viscosity == "implicit" else max(rate, viscous_rate(scene))


def _first_obstacle(scene: Any, implicit: Any) -> str:
    """Return a clause on the first thing that a scene has beside which it cannot be implicit.

    Args:
        scene: The scene.
        implicit: The same with an implicit pressure.
    """
    own = {**COMPANIONS, "gradient": "mls"}
    for key, value in own.items():
        if key in scene.accuracy.model_fields_set and getattr(scene.accuracy, key) != value:
            return f"need {key} = '{value}': {scene.place(('accuracy', key))}"
    if scene.time.dt:
        return f"have no fixed length: {scene.place(('time', 'dt'))}"
    for feature in reversed(features()):
        for path, message in feature.obstacles(implicit):
            return f"{message}: {implicit.place(path)}"
    if any(material.family != "fluid" for material in scene.used_materials.values()):
        # two balls keep 0.23 of the energy with an implicit elasticity, 0.84 with an explicit one
        return "collisions of solids, sand and snow would lose more energy"
    return "gaps open between phases of liquids at rest" if _has_liquids_apart(scene) else ""


def _has_liquids_apart(scene: Any) -> bool:
    """Return whether liquids that do not mix have velocity fields of their own."""
    mixing = miscible_materials(scene.coupling)
    phases = {
        scene.phase_of(entity)
        for entity in scene.entities
        if entity.material not in (None, *mixing)
        and scene.material[entity.material].family == "fluid"
    }
    return len(phases) > 1


def find_obstacles(scene: Any) -> list[tuple[tuple, str]]:
    """Return (path of a key, message) of all that an implicit pressure does not know."""
    errors = [*_materials(scene), *_couplings(scene)]
    liquids = [(n, m) for n, m in scene.used_materials.items() if m.family == "fluid"]
    densities = {material.bulk_density: name for name, material in liquids}
    if not densities:
        errors.append((("accuracy", "pressure"), "scenes without a liquid"))
    else:
        if max(densities) > MAX_CONTRAST * min(densities):
            what = f"liquids that are more than {MAX_CONTRAST:,.0f} times as heavy as others"
            errors.append((("material", densities[min(densities)], "density"), what))
        errors += _bodies(scene)
        for feature in features():
            for name in () if feature.suits_implicit_pressure else feature.lists:
                if scene.lists[name]:
                    errors.append(((name, 0), feature.title))
        if any(time is not None for time in scene.domain.wall_opening_times):
            errors.append((("domain", "boundary"), "walls that open"))
    return [(path, f"accuracy.pressure = 'implicit' is not for {what}") for path, what in errors]


def _materials(scene: Any) -> list[tuple[tuple, str]]:
    """Return (path of a key, noun phrase) of materials."""
    errors = []
    for name, material in scene.used_materials.items():
        if material.kind == "fluid":
            if material.tension == "off":
                errors.append((("material", name, "tension"), "liquids without tension"))
        elif material.family == "fluid" or scene.accuracy.elasticity == "explicit":
            errors.append((("material", name, "kind"), "materials that are no fluid"))
    return errors


def _couplings(scene: Any) -> list[tuple[tuple, str]]:
    """Return (path of a key, noun phrase) of couplings."""
    errors = []
    for k, coupling in enumerate(scene.coupling):
        if coupling.rule in (MIXING, DRAG) and coupling.printed:
            errors.append((("coupling", k, "kind"), f"couplings of kind {coupling.kind!r}"))
        kinds = {scene.material[name].kind for name in coupling.between}
        if coupling.rule == CONTACT and coupling.friction and "fluid" in kinds:
            errors.append((("coupling", k, "friction"), "friction of liquids"))
        if coupling.rule == DRAG and not _all_flow_through(scene, coupling):
            what = "sands through which only some of the liquids flow"
            errors.append((("coupling", k, "between"), what))
    return errors


def _all_flow_through(scene: Any, drag: Any) -> bool:
    """Return whether all liquids of a scene flow through the sand of a drag, if any object has it.

    Args:
        scene: The scene.
        drag: A coupling with drag.
    """
    sand = next(name for name in drag.between if scene.material[name].family == "sand")
    through = {
        name
        for coupling in scene.coupling
        if coupling.rule == DRAG and sand in coupling.between
        for name in coupling.between
    }
    liquids = {n for n, material in scene.used_materials.items() if material.family == "fluid"}
    return sand not in scene.used_materials or liquids <= through


def _bodies(scene: Any) -> list[tuple[tuple, str]]:
    """Return (path of a key, noun phrase) of bodies and colliders."""
    errors = []
    for k, obj in enumerate(scene.object):
        values = {
            "motion": obj.motion and not obj.collider,
            "friction": obj.friction,
            **{key: True for feature in features() for key in feature.keys_of(obj)},
        }  # fmt: skip
        values.pop("pinned", None)  # an implicit elasticity has them
        values.pop("slip_length", None)
        errors += [(("object", k, key), HELD_BODIES) for key, value in values.items() if value]
    rigid = [k for k, obj in enumerate(scene.object) if obj.rigid]
    if len(rigid) > MAX_FREE_BODIES:
        what = f"more than {MAX_FREE_BODIES} free rigid bodies"
        errors.append((("object", rigid[-1], "rigid"), what))
    return errors


FEATURE = ImplicitPressure()
