"""Cost of a run, predicted before it begins: printed by `vgmpi plan`, and kept in checkpoints.

Time, memory and disk come first, then steps, warnings and advice; details follow with -v.
"""

import math

from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.planning.region_groups import group_counts
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.runtime.message_text import format_duration
from vgmpi.runtime.process_limits import format_bytes
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

from . import tradeoff_results
from .feature_costs import step_ns
from .pilot_result import PilotRun
from .plan_details import plan_details
from .run_estimate import (
    expected_step,
    sources_meet_bodies,
    step_count,
    step_seconds,
    writing_seconds,
)
from .scene_warnings import note_lines, warning_lines
from .throughput import ASSUMED_THROUGHPUT, Throughput
from .timestep_advice import limiting_material_lines, pruning_lines

MOTION_STEP_MARGIN = 1.05  # [-] of the steps without motions, above which a line names them
# [bytes] of a particle in a frame: number, position, object, velocity field, and VTK's tables
BYTES_OF_EVERY_FRAME = 8 + 12 + 4 + 4 + 8
BYTES_OF_FIELD = {
    "velocity": 12, "J": 4, "F": 36, "stress": 24, "pressure": 4, "strain": 24,
    "volume_fraction": 4,
}  # fmt: skip


def format_plan(
    scene: Scene, plan: Plan, ranks: int, reached: float = 0.0, pace: Throughput | None = None,
    rehearsal: PilotRun | None = None, details: bool = True, choice: str = "",
) -> str:  # fmt: skip
    """Return the text of a plan: time, memory, disk and steps, then warnings, advice and details.

    Args:
        scene: The scene.
        plan: Its plan.
        ranks: Number of ranks.
        reached: Time [s] from which the run continues; steps and time are those that are left.
        pace: Throughput of the processors; if None, the time is said to be unknown.
        rehearsal: Result of a pilot run, for a run from the start.
        details: Whether phases, contacts, walls and the time per particle are told, too.
        choice: Why it is so many ranks, "" where nobody asks.
    """
    assumed = ASSUMED_THROUGHPUT[scene.accuracy.precision]
    is_known = pace is not None and pace is not assumed
    pace = pace or assumed
    nx, ny, nz = plan.cells
    title = (
        f"{escape_control_characters(scene.title or scene.path.name)}: {plan.particles:,}"
        f" particles in {nx} x {ny} x {nz} cells of {plan.dx:g} m, {scene.accuracy.precision}"
        " precision"
    )
    total = plan.bytes()
    answers, advice = _steps(scene, plan, ranks, reached, pace, rehearsal, is_known)
    memory = (
        f"  memory      {total / 2**20:.0f} MiB in all,"
        f" {total / ranks / 2**20:.0f} MiB per rank on {ranks} rank(s)"
    )
    lines = [title, answers[0], *([f"  ranks       {choice}"] if choice else []), memory]
    lines += [file_size_line(scene, plan), *answers[1:]]
    lines += [f"  warning     {line}" for line in warning_lines(scene, plan)]
    lines += [f"  note        {line}" for line in note_lines(scene, plan)]
    lines += [*scene.choices, *_advice(scene, plan), *advice]
    return "\n".join(lines + (plan_details(scene, plan, pace) if details else []))


def _unknown_part(scene: Scene, plan: Plan, pilot: PilotRun | None) -> str:
    """Return a clause on what the time does not count, or an empty text.

    Without a pilot run particles have the price of their places at the start, and those of sources
    that of a liquid that touches nothing.
    """
    if pilot is not None:
        end = float(plan.times[-1])
        if pilot.reached >= end:
            return ""
        return (
            f"; the pilot run was ended at {pilot.reached:.3g} of {end:g} s: what meets, spreads or"
            " breaks later may cost more or less"
        )
    if sources_meet_bodies(scene, plan):
        sources = [name for feature in plan.features for name in feature.source_names]
        names = ", ".join(map(escape_control_characters, sources))
        return (
            f"; what pours from {names} costs more where it meets bodies and spreads: --pilot finds"
            " out how much"
        )
    if len(plan.phases) > 1 or any(phase.is_liquid for phase in plan.phases):
        return "; what meets, spreads or breaks later may cost more: --pilot finds out how much"
    return ""


def _advice(scene: Scene, plan: Plan) -> list[str]:
    """Return lines on features that would suit the scene."""
    return [line for feature in features() for line in feature.advice_lines(scene, plan)]


def _steps(
    scene: Scene,
    plan: Plan,
    ranks: int,
    reached: float,
    pace: Throughput,
    rehearsal: PilotRun | None,
    is_known: bool,
) -> tuple[list[str], list[str]]:
    """Return the lines on duration, number of steps and time step, and those of advice."""
    dt, cause = time_step_bounds(scene, plan)[0]
    min_dt, harder = time_step_bounds(scene, plan, stiffened=True)[0]
    if plan.time_step.fixed:
        dt, min_dt, cause = plan.time_step.fixed, plan.time_step.fixed, "time.dt"
    each = step_seconds(scene, plan, ranks, pace, rehearsal)
    end, frames = float(plan.times[-1]), len(plan.times)
    left, span = end, f"{end:g} s and {frames} frames"
    if reached > 0:
        left, frames = max(end - reached, 0.0), len(plan.remaining_times(reached))
        span = f"{left:.4g} of {end:g} s and {frames} of {len(plan.times)} frames"
    few, many = (
        step_count(plan, expected_step(scene, plan, stiffened), end - left)
        for stiffened in (False, True)
    )
    if step_count(plan, dt, end - left) > MOTION_STEP_MARGIN * left / dt:
        cause += "; shorter where colliders or prescribed bodies move fast"
    cause += "".join(f"; {each.step_limit}" for each in plan.features if each.step_limit)
    if rehearsal is not None:
        few = many = math.ceil(rehearsal.steps)
    written = writing_seconds(plan, ranks, frames)
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

    if rehearsal is None and sources_meet_bodies(scene, plan):
        duration_text = duration_text.replace("about", "at least")
    unknown = _unknown_part(scene, plan, rehearsal)
    duration_line = f"{duration_text} on {ranks} rank(s), one core each, {pace.origin}{unknown}"
    if not is_known:
        duration_line = "unknown: this processor is not measured yet (--calibrate, a minute)"

    answers = [
        f"  time        {duration_line}",
        f"  steps       {steps} for {span}",
        f"  time step   {dt:.4g} s at the start, set by {cause}",
    ]
    advice = limiting_material_lines(scene, plan, compare)
    advice += pruning_lines(scene, plan, compare, lambda other: step_ns(scene, other, pace))
    return answers, advice + tradeoff_results.cheaper_setting_lines(scene)


def frame_bytes(scene: Scene, plan: Plan) -> int:
    """Return the size of a frame with all particles of a run [bytes]."""
    has_deformation = any(group.has_deformation for group in plan.groups)
    each = BYTES_OF_EVERY_FRAME
    for name in scene.output.fields:
        if name != "F" or has_deformation:
            each += BYTES_OF_FIELD[name]
    each += sum(feature.frame_bytes for feature in plan.features)
    return each * plan.particles


def checkpoint_bytes(plan: Plan) -> int:
    """Return the size of a checkpoint with all particles of a run [bytes]."""
    return sum(count * plan.bytes_per_particle(group) for count, group in group_counts(plan))


def file_size_line(scene: Scene, plan: Plan) -> str:
    """Return the line of a plan about the files."""
    frame, frames = frame_bytes(scene, plan), len(plan.times)
    return (
        f"  disk        {frames} frames of {_size(frame)}, {_size(frame * frames)} in all;"
        f" a checkpoint takes {_size(checkpoint_bytes(plan))}"
    )


def _size(size: int) -> str:
    """Return a number of bytes as text."""
    return f"{size / 2**20:.3g} MiB" if size < 2**30 else format_bytes(size)
