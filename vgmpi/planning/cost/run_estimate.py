"""Steps and time of a run, predicted from its plan and from a pilot run if there is one."""

import math
from dataclasses import replace

import numpy as np

from vgmpi.planning.plan import Plan, initial_speeds, time_step_bounds
from vgmpi.scene.scene import Scene
from vgmpi.scene.step_estimates import expected_speed

from .feature_costs import PARTICLES_PER_BLOCK, step_ns, step_overhead
from .pilot_result import PilotRun
from .throughput import Throughput

# [s] time to write a frame, and a particle in it (a run's `--profile`: write)
FRAME_SECONDS, SECONDS_PER_WRITTEN_PARTICLE = 0.025, 1e-7
# [-] overhead of ranks, fitted on two ranks to scenes of runs/
HALO_OVERHEAD = 2.0
PILOT_SECONDS = 20.0  # [s] largest processor time of a pilot run that is not asked for


def expected_step(scene: Scene, plan: Plan, stiffened: bool = False) -> float:
    """Return the mean time step [s] that is expected of a run.

    Where waves of a liquid do not bound the steps, its motion does: see `expected_speed`.

    Args:
        scene: The scene.
        plan: Its plan.
        stiffened: See `time_step_bounds`.
    """
    if plan.time_step.fixed:
        return plan.time_step.fixed
    dt = time_step_bounds(scene, plan, stiffened)[0][0]
    start_speed = max(initial_speeds(scene, plan))
    for group in plan.groups:
        if group.volume.separate_pressure:
            speed = expected_speed(scene, scene.material[group.material], start_speed)
            dt = min(dt, plan.time_step.cfl * plan.dx / speed)
    return dt


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
    steps = (
        step_count(plan, expected_step(scene, plan), 0.0)
        if pilot is None
        else math.ceil(pilot.steps)
    )
    return steps * step_seconds(scene, plan, ranks, pace, pilot) + writing_seconds(plan, ranks)


def step_seconds(
    scene: Scene, plan: Plan, ranks: int, pace: Throughput, pilot: PilotRun | None
) -> float:
    """Return the mean time [s] of a step.

    Args:
        scene: The scene.
        plan: Its plan.
        ranks: Number of ranks.
        pace: Throughput of the processors.
        pilot: Result of a pilot run.
    """
    if pilot is None:
        ns = step_ns(scene, replace(plan, count=mean_counts(plan)), pace)
        overhead = step_overhead(scene, plan)
    else:
        ns = pilot.work(scene, plan, pace).sum() / pilot.steps
        overhead = pilot.mean_overhead(pace)
    return 1e-9 * ns / ranks * rank_overhead(plan, ranks) + overhead


def sources_meet_bodies(scene: Scene, plan: Plan) -> bool:
    """Return whether what sources insert may meet bodies or colliders: its price is unknown.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    is_met = len(plan.phases) > 1 or any(obj.collider for obj in scene.object)
    return plan.has_sources and is_met


def mean_counts(plan: Plan) -> tuple[int, ...]:
    """Return the mean number of particles of each object and particle source over the run.

    Those of a source enter one after the other; what leaves the domain is not known.

    Args:
        plan: The plan.
    """
    counts = dict(enumerate(plan.count))
    for feature in plan.features:
        counts |= feature.mean_counts(plan)
    return tuple(counts.values())


def rank_overhead(plan: Plan, ranks: int) -> float:
    """Return the time of a step on several ranks over an even share of that on one.

    Nodes at the faces of a rank's piece are computed by its neighbors, too, and ranks wait for each
    other: both grow as the surface of a piece over its volume, in blocks.
    """
    blocks = sum(proximity.blocks for proximity in plan.measures.proximity)
    blocks = max(blocks, sum(plan.count) // PARTICLES_PER_BLOCK, 1)
    return 1.0 + HALO_OVERHEAD * (ranks / blocks) ** (1.0 / 3.0) * (1.0 - 1.0 / ranks)


def writing_seconds(plan: Plan, ranks: int, frames: int | None = None) -> float:
    """Return the time [s] of writing so many frames, by default all."""
    each = FRAME_SECONDS + SECONDS_PER_WRITTEN_PARTICLE * sum(plan.count) / ranks
    return each * (len(plan.times) if frames is None else frames)


def step_count(plan: Plan, dt: float, reached: float) -> int:
    """Return the number of steps until the end, with those that prescribed motions shorten.

    Args:
        plan: The plan.
        dt: Step [s] without them.
        reached: Time [s] from which the run continues.
    """
    end, count = float(plan.times[-1]), len(plan.time_step.motion_steps)
    if not count:
        return math.ceil((end - reached) / dt)
    edges = np.linspace(0.0, end, count + 1)
    share = np.clip((edges[1:] - reached) / np.diff(edges), 0.0, 1.0)
    steps = np.maximum(np.diff(edges) / dt, plan.time_step.motion_steps)
    return math.ceil(float((share * steps).sum()))
