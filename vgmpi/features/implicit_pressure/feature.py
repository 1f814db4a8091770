"""Implicit pressure of liquids: a system of equations of the grid finds it, so that steps are long.

Only the motion bounds the step. See docs/explanation/implicit-pressure.md.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import model_validator

from vgmpi.materials.material import field_error
from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.scene.scene_feature import SceneFeature


class AccuracyKeys(StrictModel):
    """Keys that the implicit pressure adds to [accuracy]."""

    pressure: Literal["explicit", "implicit"] = "explicit"
    """how the pressure of liquids is found. explicit: from the volume of each particle; its waves
    bound the step. implicit: by a system of equations of the grid, so that only the motion bounds
    the step: for scenes of liquids, with colliders without friction and free rigid bodies, to
    which they may stick, solids (see elasticity), and sands through which they flow. It needs
    transfer = "apic" and volume_correction = "none", which are then the defaults"""

    @model_validator(mode="after")
    def _check_pressure(self) -> Self:
        if self.pressure == "explicit":
            return self
        for key, value in (
            ("transfer", "apic"), ("volume_correction", "none"), ("dilatation", "particles")
        ):  # fmt: skip
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
    missing_engines = ("cuda", "numpy")

    def removes_wave_bound(self, scene: Any) -> bool:
        """Return whether the grid finds the pressure of the scene's liquid."""
        return bool(scene.accuracy.pressure == "implicit")

    def advice_lines(self, scene: Any, plan: Any) -> list[str]:
        """Return a line of the plan report on a scene that could well have it.

        Args:
            scene, plan: See `SceneFeature.advice_lines`.
        """
        from .plan import recommend_implicit_pressure

        return recommend_implicit_pressure(scene, plan)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with groups whose pressure the grid finds.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not self.removes_wave_bound(draft.scene):
            if draft.scene.domain.ambient_pressure is not None:
                message = "needs accuracy.pressure = 'implicit'; else see material.*.tension"
                raise draft.scene.error([(("domain", "ambient_pressure"), message)])
            return None, draft
        from .plan import plan_implicit_pressure

        return plan_implicit_pressure(draft)


FEATURE = ImplicitPressure()
