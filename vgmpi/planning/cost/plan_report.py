"""Cost of a run, predicted before it begins: printed by --plan and stored in every checkpoint."""

import math

import numpy as np

from vgmpi.materials.couplings.interaction import CONTACT, RULES
from vgmpi.planning.correction_intervals import shift_cost
from vgmpi.planning.implicit_pressure_rules import suits_implicit_pressure
from vgmpi.planning.inlet_schedule import InletPlan
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.planning.region_groups import group_counts
from vgmpi.planning.step_costs import COSTS
from vgmpi.planning.surface_friction import liquids_expected_to_stick
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.runtime.duration_text import format_duration
from vgmpi.scene.scene import Scene

from . import accuracy_benchmarks, tradeoff_results
from .feature_costs import PARTICLES_PER_BLOCK, feature_table, step_ns
from .file_sizes import file_size_line
from .pilot_result import STEP_SECONDS, PilotRun
from .rigid_body_lines import pinned_lines, rigid_body_lines
from .throughput import ASSUMED_THROUGHPUT, Throughput
from .timestep_advice import limiting_material_lines, pruning_lines, soft_liquid_lines

PRECISION = {
    "double": "accuracy.precision = 'single' takes half the time and memory",
    "single": "numbers of 7 digits; 'double' has 16 for twice the time",
}
THIN_CELLS = (
    6  # [cells] thickness below which a line is printed; contact reaches one cell on either side
)
# [s] time to write a frame, and a particle in it (a run's `--profile`: write)
FRAME_SECONDS, SECONDS_PER_WRITTEN_PARTICLE = 0.025, 1e-7
# [-] overhead of ranks, fitted on two ranks to scenes of `python -m tests.benchmarks predictions`
HALO_OVERHEAD = 2.0
MOTION_STEP_MARGIN = 1.05  # [-] of the steps without motions, above which a line names them
FINE_COUNT = 27  # particles per cell with which solids bend accurately enough


def format_plan(
    scene: Scene, plan: Plan, ranks: int, reached: float = 0.0, pace: Throughput | None = None,
    rehearsal: PilotRun | None = None,
) -> str:  # fmt: skip
    """Return the text of --plan: phases, memory, time step, steps, predicted time.

    Args:
        scene: The scene.
        plan: Its plan.
        ranks: Number of ranks.
        reached: Time [s] from which the run continues; steps and time are those that are left.
        pace: Throughput of the processors; if None, the time is said to be unknown.
        rehearsal: Result of a pilot run, for a run from the start.
    """
    assumed = ASSUMED_THROUGHPUT[scene.accuracy.precision]
    is_known = pace is not None and pace is not assumed
    pace = pace or assumed
    lines = [
        f"{escape_control_characters(scene.title or scene.path.name)}:"
        f" {plan.particles:,} particles,"
        f" {scene.accuracy.precision} precision ({PRECISION[scene.accuracy.precision]})"
    ]
    nx, ny, nz = plan.cells
    lines.append(f"  grid        {nx} x {ny} x {nz} cells of {plan.dx:g} m, sparse 4^3 blocks")
    for phase in plan.phases[: plan.phases_of_bodies]:
        for g, group in enumerate(plan.groups):
            if plan.phases[group.phase] is not phase:
                continue
            n = sum(count for count, group_number in group_counts(plan) if group_number == g)
            fields = ", ".join(f"{name} {size}" for name, size in plan.fields(g).items())
            lines.append(
                f"  phase       {phase.name}: {n:,} {'pinned ' * group.pinned}particles of"
                f" {group.material}"
                f" ({group.family}), {plan.bytes_per_particle(g)} bytes each: {fields};"
                f" once for all: density and {len(group.law)} numbers of the law"
            )
    lines += _regions(scene, plan)
    for a in range(plan.phases_of_bodies):
        for b in range(a + 1, plan.phases_of_bodies):
            names = f"{plan.phases[a].name} - {plan.phases[b].name}"
            rule = plan.rules.pair[a, b] if plan.rules else CONTACT
            how = f"friction {plan.friction[a][b]:g}" if rule == CONTACT else "they share space"
            lines.append(f"  {RULES[rule]:11s} {names}: {how}")
    lines += _walls(plan)
    lines += rigid_body_lines(scene, plan) + pinned_lines(plan) + _joints(scene)
    lines += _slip(scene) + _flows(plan)
    lines += _accuracy_notes(scene, plan)
    lines += accuracy_benchmarks.preset_accuracy_lines(scene) + feature_table(scene, plan, pace)
    total = plan.bytes()
    lines.append(
        f"  memory      {total / 2**20:.0f} MiB in all,"
        f" {total / ranks / 2**20:.0f} MiB per rank on {ranks} rank(s)"
    )
    lines.append(file_size_line(scene, plan))
    return "\n".join(lines + _steps(scene, plan, ranks, reached, pace, rehearsal, is_known))


def _walls(plan: Plan) -> list[str]:
    """Return the lines about the walls of the domain."""
    is_liquid = [phase.is_liquid for phase in plan.phases]
    walls = []
    for k, (wall, friction) in enumerate(plan.walls_of_solids):
        kind = plan.walls[k][0]
        if kind != wall and any(is_liquid):
            wall = kind if all(is_liquid) else f"{kind} for liquids and {wall} for the rest"
        time = "" if plan.opens[k] is None else f" until {plan.opens[k]:g} s"
        walls.append(wall + (f" (friction {friction:g})" if friction else "") + time)
    holding = [f"  walls       {holding_wall_line(name)}" for name in plan.holding_walls]
    return ["  walls       " + ", ".join(walls), *holding]


def holding_wall_line(name: str) -> str:
    """Return a line about a slip wall that bodies of solids or grains touch at the start."""
    return (
        f"{name} is slip: it also holds back bodies that pull away from it; separate lets them go"
    )


def _regions(scene: Scene, plan: Plan) -> list[str]:
    """Return a line for each region of a body."""
    return [
        f"  region      {escape_control_characters(scene.object[region.thing].name)}:"
        f" {region.particles:,} of its {plan.count[region.thing]:,} particles are of"
        f" {escape_control_characters(plan.groups[region.group].material)}"
        for region in plan.regions
    ]


def _joints(scene: Scene) -> list[str]:
    """Return the line that names the joints."""
    joints = [f"{joint.kind} of {' and '.join(joint.between)}" for joint in scene.joint]
    return [f"  joints      {_listing(joints)}"] if joints else []


def _thin_walls(scene: Scene) -> list[str]:
    """Return the line that names the thin walls."""
    names = [obj.name for obj in scene.object if obj.thin]
    if not names:
        return []
    return [f"  thin walls  {_listing(names)}: what flows on one side does not feel the other"]


def _slip(scene: Scene) -> list[str]:
    """Return the lines on colliders that liquids stick to, and on liquids that should stick."""
    colliders = [obj for obj in scene.object if obj.collider]
    lines = [
        f"  slip        {escape_control_characters(obj.name)}: viscous liquids"
        + (f" slip with a length of {obj.slip_length:g} m" if obj.slip_length else " stick to it")
        for obj in colliders
        if obj.slip_length is not None
    ]
    free = [o.name for o in colliders if o.slip_length is None and o.friction is None]
    for name, cells in liquids_expected_to_stick(scene).items() if free else ():
        layer = "" if cells == math.inf else f"; its boundary layer is {cells:.0f} cells thick"
        lines.append(
            f"  slip        {escape_control_characters(name)} slips freely on"
            f" {_listing(free)}{layer}: object.slip_length = 0 lets it stick"
        )
    return lines


def _flows(plan: Plan) -> list[str]:
    """Return the lines on inlets and outlets; memory and time include all that enters."""
    lines = [
        f"  inlet       {escape_control_characters(source.name)}:"
        f" {source.particles:,} particles,"
        f" {len(source.mouth)} every {source.period:.4g} s, at {source.speed:.4g} m/s:"
        f" {_flow(plan, source):.4g} kg/s"
        for source in plan.sources
    ]
    return lines + [f"  outlet      {escape_control_characters(sink.name)}" for sink in plan.sinks]


def _flow(plan: Plan, source: InletPlan) -> float:
    """Return the mass flow rate of an inlet [kg/s]."""
    density = plan.groups[source.group].density
    return density * len(source.mouth) * source.volume / source.period


def _accuracy_notes(scene: Scene, plan: Plan) -> list[str]:
    """Return the lines on what the scene's resolution and options make inexact."""
    lines = _thin_walls(scene) + _restored(plan) + _without_cells(scene, plan)
    lines += _pressure(scene, plan)
    lines += soft_liquid_lines(scene, plan.weights, plan.tensions)
    lines += _thin(scene, plan)
    return lines + _sheets(plan) + _bending(scene, plan)


def _restored(plan: Plan) -> list[str]:
    """Return the line on the cost of the transfer correction and its cheaper alternative."""
    if not plan.restores:
        return []
    often = f"every {plan.restores} steps" if plan.restores > 1 else "with every step"
    less = _relative_cost_of_apic(plan)
    return [
        f"  transfer    what transfers take from motion is given back {often};"
        f' accuracy.transfer = "apic" takes {less:.2f} of the time, and waves and spin die sooner'
    ]


def _relative_cost_of_apic(plan: Plan) -> float:
    """Return the cost of the same steps with APIC transfers: shifts of particles need some, too."""
    shifting = sum(n for n, g in group_counts(plan) if plan.groups[g].shifts)
    corrected, apic = 1.0 + COSTS.correction.total / plan.restores, 1.0
    if shifting:
        share, interval = shifting / plan.particles, plan.shift_interval
        corrected += share * shift_cost(True, interval, by_volume=False).total
        apic += share * shift_cost(False, interval, by_volume=False).total
    return apic / corrected


def _without_cells(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on the liquids that do not follow the dilatation by cells asked for."""
    if scene.accuracy.dilatation != "cells":
        return []
    names = [group.name for group in plan.groups if group.is_liquid and not group.cell_dilatation]
    message = "by particles: only liquids that share no space with others follow cells"
    return [f"  dilatation  {_listing(names)} {message}"] if names else []


def _pressure(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on scenes for which an implicit pressure is the better choice."""
    bounds = time_step_bounds(scene, plan)
    viscous = [bound for bound, cause in bounds if "viscosity" in cause]
    is_bound_by_waves = not plan.fixed_dt and min(viscous, default=math.inf) > 4.0 * bounds[0][0]
    if not (is_bound_by_waves and suits_implicit_pressure(scene, plan.groups, plan.phases)):
        return []
    return [
        '  pressure    accuracy.pressure = "implicit" suits this scene: 3 to 11 times fewer steps,'
        " at equal or smaller error"
    ]


def _listing(names: list[str]) -> str:
    return ", ".join(map(escape_control_characters, names))


def _thin(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on solid bodies too thin for exact coupling with the fluids they may touch."""
    bodies = [
        f"{escape_control_characters(scene.object[k].name)} {thick / plan.dx:.1f}"
        for k, thick in enumerate(plan.thickness)
        if thick < THIN_CELLS * plan.dx
    ]
    if not bodies:
        return []
    message = f"cells thick, under {THIN_CELLS}: how fluids carry and touch such bodies is inexact"
    return [f"  thin        {', '.join(bodies)} {message}"]


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
        scene.things[k].particles_per_cell
        for phase in plan.phases if phase.families == ("solid",) for k in phase.objects
        if scene.things[k].particles_per_cell < FINE_COUNT
    }  # fmt: skip
    if not counts:
        return []
    message = (
        "particles per cell of solids: what bends far is up to 10 % too soft"
        f" ({FINE_COUNT}: 6 %, 64:"
    )
    return [f"  bending     {', '.join(map(str, sorted(counts)))} {message} 4 %)"]


def _steps(
    scene: Scene,
    plan: Plan,
    ranks: int,
    reached: float,
    pace: Throughput,
    rehearsal: PilotRun | None,
    is_known: bool,
) -> list[str]:
    """Return the lines on time step, number of steps and duration, also with hardened laws."""
    dt, cause = time_step_bounds(scene, plan)[0]
    min_dt, harder = time_step_bounds(scene, plan, stiffened=True)[0]
    if plan.fixed_dt:
        dt, min_dt, cause = plan.fixed_dt, plan.fixed_dt, "time.dt"
    each = _step_seconds(scene, plan, ranks, pace, rehearsal)
    end, frames = float(plan.times[-1]), len(plan.times)
    left, span = end, f"{end:g} s and {frames} frames"
    if reached > 0:
        left, frames = max(end - reached, 0.0), len(plan.ahead(reached))
        span = f"{left:.4g} of {end:g} s and {frames} of {len(plan.times)} frames"
    few, many = (_step_count(plan, d, end - left) for d in (dt, min_dt))
    if few > MOTION_STEP_MARGIN * left / dt:
        cause += "; shorter where colliders or prescribed bodies move fast"
    if plan.free_bodies:
        cause += "; shorter where rigid bodies or spray are fast"
    if rehearsal is not None:
        few = many = math.ceil(rehearsal.steps)
    written = _writing_seconds(plan, ranks, frames)
    steps, duration_text = f"about {few:,}", f"about {format_duration(few * each + written)}"
    if many > 1.1 * few:
        steps, duration_text = (
            f"{few:,} to {many:,}",
            f"{format_duration(few * each + written)} to {format_duration(many * each + written)}",
        )
        cause += f"; down to {min_dt:.4g} s where {harder} hardens"

    def compare(factor: float) -> str:
        """Return the time of the run with a factor on its steps, beside that of the run."""
        if not is_known:
            return f"{factor:.2g} of the time"
        less, all_of_it = (format_duration(f * few * each + written) for f in (factor, 1.0))
        return f"about {less} instead of {all_of_it}"

    duration_line = f"{duration_text} on {ranks} rank(s), one core each, {pace.of}"
    if not is_known:
        duration_line = "unknown: this processor is not measured yet (--calibrate, a minute)"

    return [
        f"  time step   {dt:.4g} s at the start, set by {cause}",
        f"  steps       {steps} for {span}",
        *limiting_material_lines(scene, plan, compare),
        *pruning_lines(scene, plan, compare, lambda other: step_ns(scene, other, pace)),
        *tradeoff_results.cheaper_setting_lines(scene),
        f"  time        {duration_line}",
    ]


def predicted_seconds(
    scene: Scene, plan: Plan, ranks: int, pace: Throughput, pilot: PilotRun | None = None
) -> float:
    """Return the time [s] of a run from its start, without start-up and compilation.

    Args:
        scene: The scene.
        plan: Its plan.
        ranks: Number of ranks.
        pace: Throughput of the processors.
        pilot: Result of a pilot run.
    """
    dt = plan.fixed_dt or time_step_bounds(scene, plan)[0][0]
    steps = _step_count(plan, dt, 0.0) if pilot is None else math.ceil(pilot.steps)
    return steps * _step_seconds(scene, plan, ranks, pace, pilot) + _writing_seconds(plan, ranks)


def _step_seconds(
    scene: Scene, plan: Plan, ranks: int, pace: Throughput, pilot: PilotRun | None
) -> float:
    """Return the mean time [s] of a step."""
    if pilot is None:
        ns = step_ns(scene, plan, pace)
    else:
        ns = pilot.work(scene, plan, pace).sum() / pilot.steps
    return 1e-9 * ns / ranks * rank_overhead(plan, ranks) + STEP_SECONDS


def rank_overhead(plan: Plan, ranks: int) -> float:
    """Return the time of a step on several ranks over an even share of that on one.

    Nodes at the faces of a rank's piece are computed by its neighbors, too, and ranks wait for each
    other: both grow as the surface of a piece over its volume, in blocks.
    """
    blocks = sum(proximity.blocks for proximity in plan.surroundings)
    blocks = max(blocks, sum(plan.count) // PARTICLES_PER_BLOCK, 1)
    return 1.0 + HALO_OVERHEAD * (ranks / blocks) ** (1.0 / 3.0) * (1.0 - 1.0 / ranks)


def _writing_seconds(plan: Plan, ranks: int, frames: int | None = None) -> float:
    """Return the time [s] of writing so many frames, by default all."""
    each = FRAME_SECONDS + SECONDS_PER_WRITTEN_PARTICLE * sum(plan.count) / ranks
    return each * (len(plan.times) if frames is None else frames)


def _step_count(plan: Plan, dt: float, reached: float) -> int:
    """Return the number of steps until the end, with those that prescribed motions shorten.

    Args:
        plan: The plan.
        dt: Step [s] without them.
        reached: Time [s] from which the run continues.
    """
    end, count = float(plan.times[-1]), len(plan.motion_steps)
    if not count:
        return math.ceil((end - reached) / dt)
    edges = np.linspace(0.0, end, count + 1)
    share = np.clip((edges[1:] - reached) / np.diff(edges), 0.0, 1.0)
    steps = np.maximum(np.diff(edges) / dt, plan.motion_steps)
    return math.ceil(float((share * steps).sum()))
