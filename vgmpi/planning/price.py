"""What a run will cost, told before it begins: what --plan prints, and every checkpoint carries."""

import math

from ..couplings.base import CONTACT, RULES
from ..scene.scene import Scene
from ..source import printable
from . import marks, studied
from .advice import stiffer
from .features import step, table
from .groups import RESTORING_COST
from .inflow import SourcePlan
from .pace import ASSUMED, Pace
from .plan import Plan, fastest
from .rehearsal import STEP, Rehearsal

PRECISION = {
    "double": "accuracy.precision = 'single' takes half the time and memory",
    "single": "numbers of 7 digits; 'double' has 16 for twice the time",
}
THIN = 6  # cells, of which contact reaches over one on either side
# [s] of a frame, and of a particle in it (a run's `--profile`: write)
FRAME, WRITTEN = 0.065, 1e-7
FINE = 27  # particles per cell of solids that bend well enough


def describe(
    scene: Scene, plan: Plan, ranks: int, reached: float = 0.0, pace: Pace | None = None,
    rehearsal: Rehearsal | None = None,
) -> str:  # fmt: skip
    """What --plan prints: phases, fields, particles, memory, time step, steps, predicted time.

    reached: time [s] from which the run goes on; steps and time are those that are left. pace: of
    the processors, which is assumed where it is not given. rehearsal: what it has shown, of a run
    from the start.
    """
    pace = pace or ASSUMED[scene.accuracy.precision]
    lines = [
        f"{printable(scene.title or scene.path.name)}: {plan.particles:,} particles,"
        f" {scene.accuracy.precision} precision ({PRECISION[scene.accuracy.precision]})"
    ]
    nx, ny, nz = plan.cells
    lines.append(f"  grid        {nx} x {ny} x {nz} cells of {plan.dx:g} m, sparse 4^3 blocks")
    for phase in plan.phases:
        for g, group in enumerate(plan.groups):
            if plan.phases[group.phase] is not phase:
                continue
            n = sum(plan.count[k] for k in phase.objects if plan.group_of[k] == g)
            fields = ", ".join(f"{name} {size}" for name, size in plan.fields(g).items())
            lines.append(
                f"  phase       {phase.name}: {n:,} particles of {group.material}"
                f" ({group.family}), {plan.bytes_per_particle(g)} bytes each: {fields};"
                f" once for all: density and {len(group.law)} numbers of the law"
            )
    for a in range(len(plan.phases)):
        for b in range(a + 1, len(plan.phases)):
            names = f"{plan.phases[a].name} - {plan.phases[b].name}"
            rule = plan.rules.pair[a, b] if plan.rules else CONTACT
            how = f"friction {plan.friction[a][b]:g}" if rule == CONTACT else "they share space"
            lines.append(f"  {RULES[rule]:11s} {names}: {how}")
    lines.append(
        "  walls       "
        + ", ".join(
            f"{w[0]}"
            + (f" (friction {w[1]:g})" if w[1] else "")
            + (f" until {time:g} s" if time is not None else "")
            for w, time in zip(plan.walls, plan.opens, strict=True)
        )
    )
    lines += _flows(plan)
    lines += _restored(plan) + _thin(scene, plan) + _sheets(plan) + _bending(scene, plan)
    lines += marks.told(scene) + table(scene, plan, pace)
    total = plan.bytes()
    lines.append(
        f"  memory      {total / 2**20:.0f} MiB in all,"
        f" {total / ranks / 2**20:.0f} MiB per rank on {ranks} rank(s)"
    )
    return "\n".join(lines + _steps(scene, plan, ranks, reached, pace, rehearsal))


def _flows(plan: Plan) -> list[str]:
    """What comes, and where it ends: memory and time are told for all of it."""
    found = [
        f"  source      {printable(source.name)}: {source.layers * len(source.mouth):,} particles,"
        f" {len(source.mouth)} every {source.period:.4g} s, at {source.speed:.4g} m/s:"
        f" {_flow(plan, source):.4g} kg/s"
        for source in plan.sources
    ]
    return found + [f"  sink        {printable(sink.name)}" for sink in plan.sinks]


def _flow(plan: Plan, source: SourcePlan) -> float:
    """Mass that a source brings per time [kg/s]."""
    density = plan.groups[source.group].density
    return density * len(source.mouth) * source.volume / source.period


def _restored(plan: Plan) -> list[str]:
    """What it costs to restore motion, and what would cost less."""
    if not plan.restores:
        return []
    often = f"every {plan.restores} steps" if plan.restores > 1 else "with every step"
    less = 1 / (1 + RESTORING_COST / plan.restores)
    return [
        f"  transfer    what transfers take from motion is given back {often};"
        f' accuracy.transfer = "apic" takes {less:.2f} of the time, and waves and spin die sooner'
    ]


def _thin(scene: Scene, plan: Plan) -> list[str]:
    """A line where solid bodies that fluids may touch are so thin that it is inexact."""
    found = [
        f"{printable(scene.object[k].name)} {thick / plan.dx:.1f}"
        for k, thick in enumerate(plan.thickness)
        if thick < THIN * plan.dx
    ]
    if not found:
        return []
    said = f"cells thick, under {THIN}: how fluids carry and touch such bodies is inexact"
    return [f"  thin        {', '.join(found)} {said}"]


def _sheets(plan: Plan) -> list[str]:
    """Name the solids that contact knows by their particles alone."""
    if not any(phase.surface for phase in plan.phases):
        return []
    found = [p.name for p in plan.phases if p.families == ("solid",) and not p.surface]
    if not found:
        return []
    said = "thinner than some two cells: their sides touch by particles, less exactly"
    return [f"  sheets      {', '.join(map(printable, found))} {said}"]


def _bending(scene: Scene, plan: Plan) -> list[str]:
    """Say of solids with few particles how soft they are (tests/physics/test_cantilever.py)."""
    found = {
        scene.things[k].particles_per_cell
        for phase in plan.phases if phase.families == ("solid",) for k in phase.objects
        if scene.things[k].particles_per_cell < FINE
    }  # fmt: skip
    if not found:
        return []
    said = f"particles per cell of solids: what bends far is up to 10 % too soft ({FINE}: 6 %, 64:"
    return [f"  bending     {', '.join(map(str, sorted(found)))} {said} 4 %)"]


def _steps(
    scene: Scene, plan: Plan, ranks: int, reached: float, pace: Pace, seen: Rehearsal | None
) -> list[str]:
    """The time step, how many of them, and what they take: up to what hardening laws may make."""
    dt, what = fastest(scene, plan)[0]
    least, harder = fastest(scene, plan, stiffened=True)[0]
    if plan.fixed_dt:
        dt, least, what = plan.fixed_dt, plan.fixed_dt, "time.dt"
    each = 1e-9 * step(scene, plan, pace) / ranks + STEP  # seconds of a step
    if seen is not None:
        each = 1e-9 * seen.work(scene, plan, pace).sum() / seen.steps / ranks + STEP
    end, frames = float(plan.times[-1]), len(plan.times)
    left, span = end, f"{end:g} s and {frames} frames"
    if reached > 0:
        left, frames = max(end - reached, 0.0), len(plan.ahead(reached))
        span = f"{left:.4g} of {end:g} s and {frames} of {len(plan.times)} frames"
    few, many = (math.ceil(left / d) for d in (dt, least))
    if seen is not None:
        few = many = math.ceil(seen.steps)
    written = (FRAME + WRITTEN * sum(plan.count) / ranks) * frames
    steps, takes = f"about {few:,}", f"about {duration(few * each + written)}"
    if many > 1.1 * few:
        steps, takes = (
            f"{few:,} to {many:,}",
            f"{duration(few * each + written)} to {duration(many * each + written)}",
        )
        what += f"; down to {least:.4g} s where {harder} hardens"
    return [
        f"  time step   {dt:.4g} s at the start, set by {what}",
        f"  steps       {steps} for {span}",
        *stiffer(scene, plan),
        *studied.told(scene),
        f"  time        {takes} on {ranks} rank(s), one core each, {pace.of}",
    ]


def duration(seconds: float) -> str:
    """For people."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
