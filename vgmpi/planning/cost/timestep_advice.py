"""Advice of --plan on settings that would allow longer time steps, with their keys and places."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.liquid_stiffness import GRAVITY, Liquid
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

TOLERATED_COMPRESSION = 2.0  # [-] of max_compression, by weight, above which a line is given
MAX_RIGID_STRAIN = 1e-3  # [-] strain by weight and impact below which a body counts as rigid
MIN_STEP_GAIN = 1.5  # [-] gain in step length above which a line of advice is given
UNITS = {
    "youngs_modulus": "Pa", "shear_modulus": "Pa", "tait_coefficient": "Pa", "max_speed": "m/s",
    "max_depth": "m", "viscosity": "Pa s",
}  # fmt: skip
# powers of the step's gain by which a key becomes less; 2 for moduli
POWERS = {"max_speed": 1, "viscosity": 1}
PRUNED_PER_CELL = 8  # particles per cell that prune = "auto" keeps
MIN_PRUNING_GAIN = 3  # [-] particles over those kept, above which a line of advice is given
KEYS = ("youngs_modulus", "shear_modulus")  # the key of a solid's stiffness, in order of search


def stiffness_key(material: Any) -> str:
    """Return the key by which the scene gives the stiffness of a material."""
    if isinstance(material, Liquid):
        speed_keys = ("max_speed", "max_depth")
        return next((k for k in speed_keys if getattr(material, k) is not None), "tait_coefficient")
    return next(k for k in KEYS if k in type(material).model_fields)


def soft_liquid_lines(scene: Scene, weights: tuple[float, ...]) -> list[str]:
    """Return a line for each liquid that its own weight compresses more than is intended.

    Args:
        scene: The scene.
        weights: Weight per area on the bottom of each body of liquid [Pa], NaN for other objects.
    """
    heaviest: dict[str, float] = {}
    for entity, weight in zip(scene.things, weights, strict=False):
        if entity.material is not None and not math.isnan(weight):
            heaviest[entity.material] = max(heaviest.get(entity.material, 0.0), weight)
    lines = []
    for name, weight in heaviest.items():
        liquid: Any = scene.material[name]
        compression = -math.expm1(float(liquid.theta_under(weight)))
        if compression <= TOLERATED_COMPRESSION * liquid.max_compression:
            continue
        key, allowed = stiffness_key(liquid), liquid.max_compression
        value = {
            "max_speed": math.sqrt(weight / liquid.density),
            "max_depth": weight / (liquid.density * GRAVITY),
            "tait_coefficient": weight / (allowed * liquid.tait_exponent),
        }[key]
        lines.append(
            f"  soft        {escape_control_characters(name)}: the weight of the liquid compresses"
            f" it by {100 * compression:.2g} % at the bottom; at"
            f" {scene.place(('material', name, key))} = {value:.2g} {UNITS[key]} it is"
            f" {100 * allowed:g} %"
        )
    return lines


def limiting_material_lines(scene: Scene, plan: Plan, compare: Callable[[float], str]) -> list[str]:
    """Name the material that alone limits the time step, where the others allow longer steps.

    Args:
        scene: The scene.
        plan: Its plan.
        compare: Function of a factor on the run's time that returns both times as text.
    """
    bounds = time_step_bounds(scene, plan)
    dt, limit = bounds[0]
    slower = [bound for bound, cause in bounds if cause != limit]
    if plan.fixed_dt or not slower or slower[0] < MIN_STEP_GAIN * dt:
        return []
    keys = {f"material {name!r}": (name, stiffness_key(m)) for name, m in scene.material.items()}
    keys |= {f"the viscosity of material {name!r}": (name, "viscosity") for name in scene.material}
    if limit not in keys:
        return []
    times, (name, key) = slower[0] / dt, keys[limit]
    where = scene.place(("material", name, key))
    value = getattr(scene.material[name], key) / times ** POWERS.get(key, 2)
    return [
        f"  advice      without {escape_control_characters(limit)} steps would be"
        f" {times:.1f} times as long: they grow as {where} becomes less;"
        f" at {value:.2g} {UNITS[key]} {compare(1 / times)}{_rigid_clause(scene, plan, name)}"
    ]


def _rigid_clause(scene: Scene, plan: Plan, name: str) -> str:
    """Return the advice to make the bodies of a stiff solid rigid, or an empty text.

    What remains has particles, since another bound of the step exists.

    Args:
        scene: The scene.
        plan: Its plan.
        name: Name of the material that limits the time step.
    """
    has_others = any(coupling.rule != CONTACT for coupling in scene.coupling)
    if scene.material[name].family != "solid" or scene.accuracy.keeps or has_others:
        return ""
    rows = [k for k, obj in enumerate(scene.object) if name in scene.materials_of(obj)]
    if any(scene.object[k].region for k in rows):
        return ""
    if not rows or any(scene.object[k].driven or plan.group_of[k] < 0 for k in rows):
        return ""
    stiff = min(plan.stiff[plan.groups[plan.group_of[k]].phase] for k in rows)
    depth, speed = plan.cells[2] * plan.dx, max(obj.speed for obj in scene.object)
    stress = max(group.density for group in plan.groups) * (
        math.hypot(*plan.gravity) * depth + speed**2
    )
    if stress > MAX_RIGID_STRAIN * stiff:
        return ""
    names = ", ".join(escape_control_characters(scene.object[k].name) for k in rows)
    return (
        f"; {names}, {scene.place(('object', rows[0]))}, would deform by less than"
        f" {100 * MAX_RIGID_STRAIN:g} %: rigid = true saves as much"
    )


def pruning_lines(
    scene: Scene, plan: Plan, compare: Callable[[float], str], step_time: Callable[[Plan], float]
) -> list[str]:
    """Name captures and meshes with many more particles than prune = "auto" would keep.

    Args:
        scene: The scene.
        plan: Its plan.
        compare: Function of a factor on the run's time that returns both times as text.
        step_time: Function of a plan that returns the time of a step.
    """
    lines = []
    for k, obj in enumerate(scene.object):
        if obj.role != "body" or obj.shape is not None or obj.prune != "off" or not plan.volumes:
            continue
        if obj.region:  # how many particles of each would remain is not known
            continue
        pruned_count = round(PRUNED_PER_CELL * plan.volumes[k] / plan.dx**3)
        if plan.count[k] < MIN_PRUNING_GAIN * max(pruned_count, 1):
            continue
        count = (*plan.count[:k], pruned_count, *plan.count[k + 1 :])
        factor = step_time(replace(plan, count=count)) / step_time(plan)
        solid = scene.material_of(obj).family == "solid"
        keys = 'prune = "auto" and passive_gaussians = true' if solid else 'prune = "auto"'
        lines.append(
            f"  advice      {scene.place(('object', k))}: {keys} keep about {pruned_count:,} of its"
            f" {plan.count[k]:,} particles and the same look at rest:"
            f" {compare(factor)}"
        )
    return lines
