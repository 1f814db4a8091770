"""Slip of viscous liquids on colliders, rigid bodies and solids: keys of scenes and their checks.

See docs/explanation/contact.md, liquids that stick.
"""

import math
from typing import Annotated, Any

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene_feature import Errors, SceneFeature

# a boundary layer over this length [cells], of a flow that fell as far, is compared with the cells
FLOW_LENGTH_CELLS = 10.0
RESOLVED_LAYER_CELLS = 3.0  # [cells] thickness of a boundary layer above which a liquid sticks


class ObjectKeys(StrictModel):
    """Keys that surface slip adds to [[object]]."""

    slip_length: Annotated[float, Quantity("m", ge=0)] | None = None
    """colliders and bodies of solids only: distance behind the surface at which the velocity of a
    viscous liquid, continued in a straight line, is that of the surface. 0: it sticks. Default: it
    slips freely"""


class SurfaceSlip(SceneFeature):
    """Slip lengths in the tables of a scene."""

    name, title = "surface_slip", "slip lengths"
    object_keys = ObjectKeys
    missing_engines = ("cuda",)

    def check_object(self, raw: dict, is_scenery: bool) -> Errors:
        """Return the errors of keys of an object that do not go together with `slip_length`."""
        if "slip_length" not in raw:
            return []
        if is_scenery and raw.get("collider") is not True:
            message = "is only for bodies of solids and scenery with collider = true"
            return [(("slip_length",), message)]
        if "friction" in raw:
            return [(("slip_length",), "friction and slip_length given at once: give one")]
        return []

    def check_scene(self, objects: list, materials: dict, couplings: list, accuracy: Any) -> Errors:
        """Return what a scene with slip lengths cannot have.

        Args:
            objects, materials, couplings, accuracy: See `SceneFeature.check_scene`.
        """
        errors: Errors = []
        viscous = [material.dynamic_viscosity for material in materials.values() if material]
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
            elif accuracy is not None and accuracy.is_flip:
                errors.append((key, f'is not for accuracy.transfer = "{accuracy.transfer}"'))
            elif any(coupling is not None and coupling.rule != CONTACT for coupling in couplings):
                message = "is not for scenes in which materials mix or flow through sand"
                errors.append((key, message))
            elif own is not None and not obj.rigid:
                errors += _friction_besides(key, obj.material, materials, couplings)
        return errors

    def note_lines(self, scene: Any) -> list[str]:
        """Return a line on each liquid that slips on surfaces and is viscous enough to stick."""
        solids = [name for name, material in scene.material.items() if material.family == "solid"]
        free = [
            o.name
            for o in scene.object
            if (o.collider or o.material in solids) and o.slip_length is None and o.friction is None
        ]
        names = ", ".join(map(escape_control_characters, free))
        lines = []
        for name, cells in liquids_expected_to_stick(scene).items() if free else ():
            layer = "" if cells == math.inf else f"; its boundary layer is {cells:.0f} cells thick"
            lines.append(
                f"{escape_control_characters(name)} slips freely on {names}{layer}:"
                " object.slip_length = 0 lets it stick"
            )
        return lines

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the slip, and the draft.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if all(obj.slip_length is None for obj in draft.scene.object):
            return None, draft
        from .plan import plan_surface_slip

        return plan_surface_slip(draft), draft


def _friction_besides(key: tuple, solid: str, materials: dict, couplings: list) -> Errors:
    """Return the error if a coupling names the friction of a viscous liquid on a solid."""
    for coupling in couplings:
        if coupling is None or solid not in coupling.between or not coupling.friction:
            continue
        for liquid in coupling.between:
            if liquid != solid and materials[liquid].dynamic_viscosity:
                names = f"{liquid!r} and {solid!r}"
                return [(key, f"the coupling of {names} has friction: give one of the two")]
    return []


def liquids_expected_to_stick(scene: Any) -> dict[str, float]:
    """Return viscous liquids whose boundary layers the cells resolve, with the thickness [cells].

    The layer is that of Blasius, 5 sqrt(nu L / U), over a length L of ten cells at the speed U of a
    fall over ten cells. The thickness is infinite for liquids with a yield stress.

    References:
        Schlichting (1979): Boundary-layer theory, section 7.
    """
    length = FLOW_LENGTH_CELLS * scene.domain.cell
    speed = math.sqrt(2.0 * math.hypot(*scene.domain.gravity) * length)
    if speed == 0.0:
        return {}
    thick = {}
    for name, material in scene.material.items():
        eta = material.dynamic_viscosity
        layer = 5.0 * math.sqrt(eta / material.bulk_density * length / speed)
        if layer >= RESOLVED_LAYER_CELLS * scene.domain.cell:
            thick[name] = layer / scene.domain.cell
    return thick


FEATURE = SurfaceSlip()
