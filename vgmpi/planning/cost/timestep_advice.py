"""Advice of a plan on settings that would allow longer time steps, with their keys and places."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.materials.liquid_stiffness import GRAVITY, Liquid
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

TOLERATED_COMPRESSION = 2.0  # [-] of max_compression, above which a line is given
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


def soft_liquid_lines(
    scene: Scene, weights: tuple[float, ...], tensions: tuple[float, ...] = ()
) -> list[str]:
    """Return lines on liquids that weight or motion strains more than is intended.

    Args:
        scene: The scene.
        weights: Weight per area on the bottom of each body of liquid [Pa], NaN for other objects.
        tensions: Tension of each body of liquid in a closed box [Pa], NaN for other objects.
    """
    lines = []
    for name, weight in _largest_by_liquid(scene, weights).items():
        liquid: Any = scene.material[name]
        compression = -math.expm1(float(liquid.theta_under(weight)))
        if compression > TOLERATED_COMPRESSION * liquid.max_compression:
            effect = f"the weight of the liquid compresses it by {100 * compression:.2g} %"
            lines.append(_soft_line(scene, name, f"{effect} at the bottom", weight))
    for name, tension in _largest_by_liquid(scene, tensions).items():
        liquid = scene.material[name]
        stretch = math.expm1(liquid.theta_stretched(tension))
        if liquid.tension == "on" and stretch > TOLERATED_COMPRESSION * liquid.max_compression:
            size = f"stretches it by {100 * stretch:.2g} %" if stretch < math.inf else "tears it"
            effect = f"it fills a closed box, where its motion at the start {size}"
            lines.append(_soft_line(scene, name, effect, tension))
    return lines


def _largest_by_liquid(scene: Scene, pressures: tuple[float, ...]) -> dict[str, float]:
    """Return the largest of the pressures [Pa] of each liquid's bodies, by its name."""
    result: dict[str, float] = {}
    for entity, pressure in zip(scene.entities, pressures, strict=False):
        if entity.material is not None and not math.isnan(pressure):
            result[entity.material] = max(result.get(entity.material, 0.0), pressure)
    return result


def _soft_line(scene: Scene, name: str, effect: str, pressure: float) -> str:
    """Return the line on a soft liquid, with the key and value at which it is stiff enough.

    Args:
        scene: The scene.
        name: Name of the liquid.
        effect: What happens to it.
        pressure: Pressure or tension that strains it [Pa].
    """
    liquid: Any = scene.material[name]
    key, allowed = stiffness_key(liquid), liquid.max_compression
    value = {
        "max_speed": math.sqrt(pressure / liquid.density),
        "max_depth": pressure / (liquid.density * GRAVITY),
        "tait_coefficient": pressure / (allowed * liquid.tait_exponent),
    }[key]
    return (
        f"{escape_control_characters(name)} is soft: {effect}; at"
        f" {scene.place(('material', name, key))} = {value:.2g} {UNITS[key]} it is"
        f" {100 * allowed:g} %"
    )


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
    if plan.time_step.fixed or not slower or slower[0] < MIN_STEP_GAIN * dt:
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
        f" at {value:.2g} {UNITS[key]} {compare(1 / times)}{rigid_clause(scene, plan, name)}"
    ]


def rigid_clause(scene: Scene, plan: Plan, name: str) -> str:
    """Return the advice to make the bodies of a stiff solid rigid, or an empty text.

    What remains has particles, since another bound of the step exists.

    Args:
        scene: The scene.
        plan: Its plan.
        name: Name of the material that limits the time step.
    """
    has_others = any(coupling.rule != CONTACT for coupling in scene.coupling)
    if scene.material[name].family != "solid" or scene.accuracy.is_flip or has_others:
        return ""
    rows = [k for k, obj in enumerate(scene.object) if name in scene.materials_of(obj)]
    if any(scene.object[k].region for k in rows):
        return ""
    moved = {k for feature in plan.features for k in feature.groups_after_release()}
    if not rows or any(k in moved or plan.group_of[k] < 0 for k in rows):
        return ""
    stiff = min(plan.contact.stiffness[plan.groups[plan.group_of[k]].phase] for k in rows)
    depth, speed = plan.cells[2] * plan.dx, max(obj.speed for obj in scene.object)
    stress = max(group.density for group in plan.groups) * (
        math.hypot(*plan.gravity.vector) * depth + speed**2
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
        if (
            obj.role != "body"
            or obj.shape is not None
            or obj.prune != "off"
            or not plan.measures.volumes
        ):
            continue
        if obj.region:  # how many particles of each would remain is not known
            continue
        pruned_count = round(PRUNED_PER_CELL * plan.measures.volumes[k] / plan.dx**3)
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
