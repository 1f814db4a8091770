"""Details of a plan, printed with -v: phases, contacts, walls, and the price of particles."""

import csv
from functools import cache
from importlib import resources
from pathlib import Path

from vgmpi.materials.couplings.interaction import CONTACT, PRESSURE, RULES
from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts
from vgmpi.planning.step_costs import COSTS
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.accuracy_presets import LEVELS
from vgmpi.scene.scene import Scene

from .feature_costs import feature_table
from .throughput import Throughput

PRECISION = {
    "double": "accuracy.precision = 'single' takes half the time and memory",
    "single": "numbers of 7 digits; 'double' has 16 for twice the time",
}
FINE_COUNT = 27  # particles per cell with which solids bend accurately enough
PATH = Path(str(resources.files(__package__))) / "accuracy_benchmarks.csv"
# measured errors and costs of the accuracy presets (`python -m tests.benchmarks.levels`).
# Units: error is a fraction, cpu is processor time in seconds.
HOW_PHASES_MEET = {PRESSURE: "one pressure keeps them apart"}
COLUMNS = ("case", "family", "what", "tolerance", "level", "error", "cpu")


def plan_details(scene: Scene, plan: Plan, pace: Throughput) -> list[str]:
    """Return the lines on everything of a plan that time, memory and files follow from.

    Args:
        scene: The scene.
        plan: Its plan.
        pace: Throughput of the processors.
    """
    lines = [f"  precision   {scene.accuracy.precision}: {PRECISION[scene.accuracy.precision]}"]
    lines += _phases(plan) + _regions(scene, plan) + _couplings(plan) + _walls(scene, plan)
    lines += [line for feature in plan.features for line in feature.report_lines(plan)]
    lines += _accuracy_notes(scene, plan)
    return lines + preset_accuracy_lines(scene) + feature_table(scene, plan, pace)


def _phases(plan: Plan) -> list[str]:
    """Return a line on the particles of each group, by phases."""
    lines = []
    for phase in plan.phases[: plan.phases_of_bodies]:
        for g, group in enumerate(plan.groups):
            if plan.phases[group.phase] is not phase or not phase.objects:
                continue
            n = sum(count for count, group_number in group_counts(plan) if group_number == g)
            fields = ", ".join(f"{name} {size}" for name, size in plan.fields(g).items())
            what = f"{group.carrier} particles".lstrip()
            lines.append(
                f"  phase       {phase.name}: {n:,} {what} of {group.material}"
                f" ({group.family}), {plan.bytes_per_particle(g)} bytes each: {fields};"
                f" once for all: density and {len(group.law)} numbers of the law"
            )
    return lines


def _couplings(plan: Plan) -> list[str]:
    """Return a line on the interaction of each two phases."""
    lines = []
    for a in range(plan.phases_of_bodies):
        for b in range(a + 1, plan.phases_of_bodies):
            names = f"{plan.phases[a].name} - {plan.phases[b].name}"
            rule = CONTACT if plan.pair_rules is None else plan.pair_rules[a, b]
            how = HOW_PHASES_MEET.get(rule, "they share space")
            if rule == CONTACT:
                how = f"friction {plan.contact.friction[a][b]:g}"
            lines.append(f"  {RULES[rule]:11s} {names}: {how}")
    return lines


def _walls(scene: Scene, plan: Plan) -> list[str]:
    """Return the lines about the walls of the domain."""
    is_liquid = [phase.is_liquid for phase in plan.phases]
    walls = []
    for k, (wall, friction) in enumerate(plan.walls.solids):
        kind = plan.walls.liquids[k][0]
        if kind != wall and any(is_liquid):
            wall = kind if all(is_liquid) else f"{kind} for liquids and {wall} for the rest"
        removal = scene.domain.wall_opening_times[k]
        time = "" if removal is None else f" until {removal:g} s"
        walls.append(wall + (f" (friction {friction:g})" if friction else "") + time)
    return ["  walls       " + ", ".join(walls)]


def _regions(scene: Scene, plan: Plan) -> list[str]:
    """Return a line for each region of a body."""
    return [
        f"  region      {escape_control_characters(scene.object[region.object].name)}:"
        f" {region.particles:,} of its {plan.count[region.object]:,} particles are of"
        f" {escape_control_characters(plan.groups[region.group].material)}"
        for region in plan.regions
    ]


def _accuracy_notes(scene: Scene, plan: Plan) -> list[str]:
    """Return the lines on what the scene's resolution and options make inexact."""
    lines = _restored(plan) + _without_cells(scene, plan)
    return lines + _sheets(plan) + _bending(scene, plan)


def _restored(plan: Plan) -> list[str]:
    """Return the line on the cost of the transfer correction and its cheaper alternative."""
    if not plan.correction_interval:
        return []
    often = (
        f"every {plan.correction_interval} steps"
        if plan.correction_interval > 1
        else "with every step"
    )
    less = _relative_cost_of_apic(plan)
    return [
        f"  transfer    what transfers take from motion is given back {often};"
        f' accuracy.transfer = "apic" takes {less:.2f} of the time, and waves and spin die sooner'
    ]


def _relative_cost_of_apic(plan: Plan) -> float:
    """Return the cost of the same steps with APIC transfers.

    Features that take part in the steps of no time then need some of their own.
    """
    correction = COSTS.correction.total
    corrected, apic = 1.0 + correction / plan.correction_interval, 1.0
    for feature in plan.features:
        for n, g in group_counts(plan) if feature.correction_interval else ():
            if (cost := feature.particle_cost(plan.groups[g], COSTS)) is not None:
                corrected += n / plan.particles * cost.total
                apic += n / plan.particles * (cost.total + correction / feature.correction_interval)
    return apic / corrected


def _without_cells(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on the liquids that do not follow the dilatation by cells asked for."""
    if scene.accuracy.dilatation != "cells":
        return []
    names = [group.name for group in plan.groups if group.is_liquid and not group.volume.by_cells]
    message = "by particles: only liquids that share no space with others follow cells"
    return [f"  dilatation  {_listing(names)} {message}"] if names else []


def _listing(names: list[str]) -> str:
    return ", ".join(map(escape_control_characters, names))


def _sheets(plan: Plan) -> list[str]:
    """Return a line on the solids that contact knows by their particles alone."""
    if not any(phase.surface for phase in plan.phases):
        return []
    names = [p.name for p in plan.phases if p.families == ("solid",) and not p.surface]
    if not names:
        return []
    message = "thinner than some two cells: their sides touch by particles, less exactly"
    return [f"  sheets      {', '.join(map(escape_control_characters, names))} {message}"]


def _bending(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on the softness of coarse solids (tests/physics/test_cantilever.py)."""
    counts = {
        scene.entities[k].particles_per_cell
        for phase in plan.phases if phase.families == ("solid",) for k in phase.objects
        if scene.entities[k].particles_per_cell < FINE_COUNT
    }  # fmt: skip
    if not counts:
        return []
    message = (
        "particles per cell of solids: what bends far is up to 10 % too soft"
        f" ({FINE_COUNT}: 6 %, 64:"
    )
    return [f"  bending     {', '.join(map(str, sorted(counts)))} {message} 4 %)"]


@cache
def accuracy_benchmarks() -> tuple[dict[str, str], ...]:
    """Return the rows of the table, one per case and preset."""
    with open(PATH, newline="") as file:
        return tuple(csv.DictReader(file))


def preset_accuracy_lines(scene: Scene) -> list[str]:
    """Return the lines of --plan on the measured error and the relative cost of the scene's preset.

    The lines use the cases nearest to the scene's materials. There are none if it has no preset.
    """
    level = scene.accuracy.level
    if level is None:
        return []
    used = {entity.material for entity in scene.entities if entity.material}
    families = {scene.material[name].family for name in used}
    rows = [row for row in accuracy_benchmarks() if row["family"] in families]
    rows = rows or list(accuracy_benchmarks())
    mine = [row for row in rows if row["level"] == level]
    errors = "; ".join(f"{row['what']} {100 * float(row['error']):.2g} %" for row in mine)
    lines = [f"  level       {level}: seen to be off by: {errors}"]
    cost = {
        other: sum(float(row["cpu"]) for row in rows if row["level"] == other) for other in LEVELS
    }
    relative = [
        f"{other} {cost[other] / cost[level]:.2g}"
        for other in LEVELS
        if other != level and cost[level]
    ]
    return [*lines, f"              time there, that of {level} being 1: {', '.join(relative)}"]
