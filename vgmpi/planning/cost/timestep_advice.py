"""Advice of --plan on settings that would allow longer time steps, with their keys and places."""

from typing import Any

from vgmpi.materials.liquid_stiffness import Liquid
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

MIN_STEP_GAIN = 1.5  # [-] gain in step length above which a line of advice is given
KEYS = ("youngs_modulus", "shear_modulus")  # the key of a solid's stiffness, in order of search


def stiffness_key(material: Any) -> str:
    """Return the key by which the scene gives the stiffness of a material."""
    if isinstance(material, Liquid):
        speed_keys = ("max_speed", "max_depth")
        return next((k for k in speed_keys if getattr(material, k) is not None), "tait_coefficient")
    return next(k for k in KEYS if k in type(material).model_fields)


def limiting_material_lines(scene: Scene, plan: Plan) -> list[str]:
    """Name the material that alone limits the time step, where the others allow longer steps."""
    bounds = time_step_bounds(scene, plan)
    dt, limit = bounds[0]
    slower = [bound for bound, cause in bounds if cause != limit]
    if plan.fixed_dt or not slower or slower[0] < MIN_STEP_GAIN * dt:
        return []
    keys = {f"material {name!r}": (name, stiffness_key(m)) for name, m in scene.material.items()}
    keys |= {f"the viscosity of material {name!r}": (name, "viscosity") for name in scene.material}
    if limit not in keys:
        return []
    times, where = slower[0] / dt, scene.place(("material", *keys[limit]))
    return [
        f"  advice      without {escape_control_characters(limit)} steps would be"
        f" {times:.1f} times as long: they grow as {where} becomes less"
    ]
