"""Warnings and notes on a scene that is valid and may not be what is meant."""

import math
from typing import Any

from vgmpi.materials.liquid_stiffness import Liquid
from vgmpi.planning.plan import Plan, initial_speeds, time_step_bounds
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

from .run_estimate import step_count
from .timestep_advice import POWERS, UNITS, rigid_clause, soft_liquid_lines, stiffness_key

MAX_SPEED_RATIO = 4.0  # [-] speed that a liquid is stiff enough for over the largest expected
MIN_STEPS_SAVED = 2.0  # [-] steps over those without a cause, from which a stiff liquid is reported
MAX_STEP_RATIO = 10.0  # [-] the same for a stiff solid
MANY_STEPS = 1_000_000  # steps of a run from which they are reported in any case
THIN_CELLS = (
    6  # [cells] thickness below which a body is reported; contact reaches a cell on each side
)


def warning_lines(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on each setting and each body that will hardly do what is meant.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    lines = soft_liquid_lines(scene, plan.measures.weights, plan.measures.tensions)
    lines += _stiff_liquids(scene, plan) + _steps(scene, plan)
    return lines + [line for feature in plan.features for line in feature.warning_lines(plan)]


def note_lines(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on each effect of the scene's settings that one may not expect.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    lines = [
        f"wall {name} is slip: it also holds back bodies that pull away from it; separate lets"
        " them go"
        for name in plan.walls.holding
    ]
    lines += [line for feature in features() for line in feature.note_lines(scene)]
    return lines + _thin(scene, plan)


def _stiff_liquids(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on the liquid that sets the step and is far stiffer than speeds here ask for.

    Scenes in which something other than gravity drives the motion have none: their speeds are
    unknown.
    """
    drop = sum(abs(g) * n * plan.dx for g, n in zip(plan.gravity.vector, plan.cells, strict=True))
    is_driven = any(feature.drives_motion for feature in plan.features)
    is_driven |= any(obj.motion is not None for obj in scene.object)
    if plan.time_step.fixed or scene.is_free_of_waves or plan.gravity.keys or is_driven or not drop:
        return []
    bounds = time_step_bounds(scene, plan)
    dt, cause = bounds[0]
    begun = initial_speeds(scene, plan)
    fastest = math.sqrt(max(begun) ** 2 + 2.0 * drop)
    for name, liquid in _liquids(scene).items():
        wave = math.sqrt(liquid.tait_coefficient * liquid.exponent / liquid.density)
        suits = wave * math.sqrt(liquid.max_compression)
        if cause != f"material {name!r}" or suits < MAX_SPEED_RATIO * fastest:
            continue
        longer = [bound for bound, other in bounds if other != cause]
        relaxed = (
            plan.time_step.cfl
            * plan.dx
            / (fastest / math.sqrt(liquid.max_compression) + max(begun))
        )
        gain = min([relaxed, *longer]) / dt
        if gain < MIN_STEPS_SAVED:
            continue
        key = stiffness_key(liquid)
        value = getattr(liquid, key) * (fastest / suits) ** POWERS.get(key, 2)
        return [
            f"{escape_control_characters(name)} is stiff enough for {suits:.2g} m/s, and what falls"
            f" here reaches {fastest:.2g} m/s: at {scene.place(('material', name, key))} ="
            f" {value:.2g} {UNITS[key]} the run takes 1/{gain:.2g} of the steps"
        ]
    return []


def _liquids(scene: Scene) -> dict[str, Any]:
    """Return the liquids that something is made of, by name."""
    used = {entity.material for entity in scene.entities}
    return {n: m for n, m in scene.material.items() if n in used and isinstance(m, Liquid)}


def _steps(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on a solid that alone makes the steps short, or on a run of very many steps."""
    bounds = time_step_bounds(scene, plan)
    dt, cause = (plan.time_step.fixed, "time.dt") if plan.time_step.fixed else bounds[0]
    count = step_count(plan, dt, 0.0)
    reason = f"about {count:,} steps of {dt:.2g} s, set by {escape_control_characters(cause)}"
    solids = {f"material {n!r}": n for n, m in scene.material.items() if m.family == "solid"}
    others = [bound for bound, other in bounds if other != cause]
    times = others[0] / dt if others else 1.0
    name = solids.get(cause)
    if name is not None and times >= MAX_STEP_RATIO:
        key = stiffness_key(scene.material[name])
        return [
            f"{reason}: {times:.0f} times as many as without it, by"
            f" {scene.place(('material', name, key))} = {getattr(scene.material[name], key):.2g}"
            f" {UNITS[key]}{rigid_clause(scene, plan, name)}"
        ]
    return [reason] if count >= MANY_STEPS else []


def _thin(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on solid bodies too thin for exact coupling with the fluids they may touch."""
    bodies = [
        f"{escape_control_characters(scene.object[k].name)} {thick / plan.dx:.1f}"
        for k, thick in enumerate(plan.measures.thickness)
        if thick < THIN_CELLS * plan.dx
    ]
    if not bodies:
        return []
    message = f"cells thick, under {THIN_CELLS}: how fluids carry and touch such bodies is inexact"
    return [f"{', '.join(bodies)} {message}"]
