"""Pilot run in coarser cells, for the cost estimate of --plan.

The cost of a step depends on where particles are: particles near other bodies cost more, and so
do blocks that are not full. A run in cells 2.5 times as large takes about a fortieth of the work.
"""

import contextlib
import logging
import math
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.feature_costs import step_ns, step_overhead
from vgmpi.planning.cost.pilot_result import CoarseStep, PilotRun, Snapshot
from vgmpi.planning.cost.run_estimate import PILOT_SECONDS, expected_step
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load_again
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import chosen_keys
from vgmpi.solver.compile_kernels import is_compiled
from vgmpi.solver.initial_particles import ParticleSummary
from vgmpi.solver.run import Runner, prepared_run
from vgmpi.solver.run_options import Options
from vgmpi.solver.run_outcome import BlowUp
from vgmpi.solver.simulation import Simulation

from .measure_proximity import blocks_at, measure_proximity

log = logging.getLogger("vgmpi")

COARSENING_FACTORS = (2.5, 2.0, 1.5)  # [scene cells] cell sizes; the first that works is taken
PADDED_FACTORS = 2.75, 2.0  # [scene cells] largest and smallest, where none of these works
OPEN_CELLS = 2  # [cells] by which open ends of such grids are farther away
MIN_CELLS = 4  # [cells] least number along the shortest edge
# [particle edges] distance from a particle's center to its finer ones, in blocks that are less than
# half full farther: coarse particles scatter over fewer blocks than fine ones do
HALF_WIDTH, SCATTERED_HALF_WIDTH, SCATTERED_FILL = 0.4, 1.5, 0.5
CORNERS = np.stack(np.meshgrid(*((-1.0, 1.0),) * 3, indexing="ij"), -1).reshape(1, 8, 3)
MAX_PILOT_SHARE = 2.0  # [-] of its time, above which a pilot run that nobody asked for is not begun
SNAPSHOTS = 24  # largest number of snapshots
ROUNDING = 1e-9  # [cells] by which an edge may differ from whole cells


class Grid(NamedTuple):
    """Grid of a pilot run."""

    cell: float  # [m]
    size: tuple[float, ...]  # [m] edges of the domain


class PilotTimeout(RuntimeError):
    """Error of a pilot run that takes longer than it may."""


def pilot_run(
    scene: Scene, plan: Plan, summary: ParticleSummary, quiet: bool = False,
    max_seconds: float = math.inf,
) -> PilotRun | None:  # fmt: skip
    """Play the scene in coarser cells on this rank alone, and write nothing.

    Args:
        scene: The scene.
        plan: Its plan.
        summary: Summary of its particles.
        quiet: Whether nothing is said, as it was not asked for.
        max_seconds: Processor time [s] after which it is given up.

    Returns:
        The result, or None, with a logged reason, if no coarser cells can play the scene.
    """
    reason, level = "it has too few cells", logging.DEBUG if quiet else logging.INFO
    for grid in _grids(scene):
        try:
            coarse = _coarsened(scene, grid)  # what fits the scene's cells may not fit these
            log.log(level, "pilot run in cells of %.4g m", coarse.domain.cell)
            with _without_messages():
                return _play(scene, plan, summary, coarse, max_seconds)
        except SceneError as error:
            reason = error.lines[0]
        except BlowUp as error:
            reason = str(error)
        except PilotTimeout:  # finer cells take longer
            reason = f"it takes more than {max_seconds:g} s"
            break
    log.log(
        logging.DEBUG if quiet else logging.WARNING,
        "no pilot run in coarser cells is possible: %s",
        reason,
    )
    return None


@contextlib.contextmanager
def _without_messages() -> Iterator[None]:
    """Leave out warnings and errors, which would be about the coarser cells."""
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def default_pilot_run(
    scene: Scene, plan: Plan, summary: ParticleSummary, pace: Throughput
) -> PilotRun | None:
    """Make the pilot run of a plan that nobody asked for, if it is short enough, without a word.

    It has `PILOT_SECONDS`; what it reaches in them is enough. Kernels must be compiled already.

    Args:
        scene: The scene.
        plan: Its plan.
        summary: Summary of its particles.
        pace: Throughput of this processor.
    """
    if pilot_seconds(scene, plan, pace) > MAX_PILOT_SHARE * PILOT_SECONDS or not is_compiled(plan):
        return None
    return pilot_run(scene, plan, summary, True, PILOT_SECONDS)


def pilot_seconds(scene: Scene, plan: Plan, pace: Throughput) -> float:
    """Return the time [s] that a pilot run takes on this core, infinity if none is possible."""
    grids = _grids(scene)
    if not grids:
        return math.inf
    ratio = scene.domain.cell / grids[0].cell
    steps = ratio * float(plan.times[-1]) / expected_step(scene, plan)
    return steps * (1e-9 * step_ns(scene, plan, pace, ratio) + step_overhead(scene, plan))


def _grids(scene: Scene) -> list[Grid]:
    """Return the coarser grids of a pilot run, the first to be tried first.

    Cells that divide every edge of the domain come first, coarsest first. Then the domain is longer
    at its upper ends, by less than a cell, and by two cells more where the end is open, so that
    particle sources near it have room: the grid that differs least from the domain comes first.
    """
    cells, dx = scene.domain.cells, scene.domain.cell
    longest, shortest = max(cells), min(cells)
    unit = longest // math.gcd(*cells)
    counts = sorted({unit * round(longest / (unit * factor)) for factor in COARSENING_FACTORS})
    grids = [
        Grid(dx * longest / n, scene.domain.size)
        for n in counts
        if MIN_CELLS * longest <= n * shortest and n < longest
    ]
    is_open = [kind == "open" for kind, _ in scene.domain.walls[1::2]]
    coarsest, finest = PADDED_FACTORS
    padded = []
    for n in range(math.ceil(longest / coarsest), math.floor(longest / finest) + 1):
        factor = longest / n
        counts = [math.ceil(m / factor - ROUNDING) for m in cells]
        excess = max(k * factor - m for k, m in zip(counts, cells, strict=True))
        if min(counts) >= MIN_CELLS:
            padding = [OPEN_CELLS * wall for wall in is_open]
            size = [(k + m) * (factor * dx) for k, m in zip(counts, padding, strict=True)]
            padded.append((excess, Grid(dx * factor, tuple(size))))
    return grids + [grid for _, grid in sorted(padded) if grid not in grids]


def _coarsened(scene: Scene, grid: Grid) -> Scene:
    """Return the scene on another grid."""
    overrides = [f"accuracy.{key}={getattr(scene.accuracy, key)}" for key in chosen_keys()]
    overrides.append(f"domain.cell={grid.cell!r}")
    if grid.size != scene.domain.size:
        overrides.append(f"domain.size={list(grid.size)!r}")
    if scene.time.dt:
        overrides.append(f"time.dt={scene.time.dt * grid.cell / scene.domain.cell!r}")
    return load_again(scene, tuple(overrides))


def _play(
    scene: Scene, plan: Plan, summary: ParticleSummary, coarse: Scene, max_seconds: float
) -> PilotRun:
    """Run the coarse scene and take snapshots at evenly chosen frames.

    Args:
        scene, plan, summary, max_seconds: See `pilot_run`.
        coarse: The scene in coarser cells.

    Raises:
        PilotTimeout: If the steps take longer than `max_seconds`.
        BlowUp: If the run ends before its first snapshot.
    """
    start, snapshots = time.monotonic(), []
    with prepared_run(coarse, SerialCommunicator(), Options(None)) as run:
        step_ratio = expected_step(coarse, run.plan) / expected_step(scene, plan)
        interval, steps_before = math.ceil(len(run.times) / SNAPSHOTS), 0
        first_second = second_before = time.process_time()

        def look(run: Runner) -> None:
            """Take a snapshot if the frame is due."""
            nonlocal steps_before, second_before
            now = time.process_time()
            if now - first_second > max_seconds:
                raise PilotTimeout
            if run.frame and (run.frame % interval == 0 or run.frame == len(run.times) - 1):
                steps, steps_before = run.simulation.step - steps_before, run.simulation.step
                step = _coarse_step(coarse, summary, run.simulation, (now - second_before) / steps)
                snapshots.append(
                    _snapshot(scene, plan, summary, run.simulation, step_ratio * steps, step)
                )
            if run.frame == 0 or run.frame % interval == 0:
                second_before = time.process_time()

        run.options.watchers.append(look)
        try:
            run.run()
        except PilotTimeout:
            if not snapshots:
                raise
    if not snapshots:
        raise BlowUp(f"in cells of {coarse.domain.cell:.4g} m the run ends early")
    reached = snapshots[-1].time
    if reached < plan.times[-1]:
        snapshots.append(_extrapolated(plan, snapshots[-1], reached / len(snapshots)))
    seconds = time.monotonic() - start
    return PilotRun(coarse.domain.cell, seconds, tuple(snapshots), float(reached))


def _extrapolated(plan: Plan, last: Snapshot, span: float) -> Snapshot:
    """Return what is expected from a snapshot to the end: steps and places stay as they are.

    Particle sources go on: blocks grow as the particles do.

    Args:
        plan: The plan of the scene.
        last: The snapshot.
        span: Time [s] of its steps.
    """
    end = float(plan.times[-1])
    number, proximity = list(last.number), list(last.proximity)
    for feature in plan.features:
        inserted = feature.inserted_counts(last.time)
        for k, count in feature.inserted_counts(0.5 * (last.time + end)).items():
            growth = count / max(inserted[k], 1)
            number[k] = round(growth * number[k])
            proximity[k] = proximity[k].scaled(growth)
    steps = last.steps / span * (end - last.time)
    return Snapshot(end, steps, tuple(number), tuple(proximity), last.coarse)


def _bodies_of(simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions (n, 3) [m], rest volumes [m3] and objects of particles, by objects."""
    groups = simulation.groups
    owner = np.concatenate([simulation.object_of(g.ids[g.index()]) for g in groups])
    order = np.argsort(owner, kind="stable")
    x = np.concatenate([g.positions() for g in groups])
    volume = np.concatenate([g.get("vol0", g.index())[:, 0] for g in groups])
    return x[order], volume[order], owner[order]


def _coarse_step(
    coarse: Scene, summary: ParticleSummary, simulation: Simulation, seconds: float
) -> CoarseStep:
    """Return the mean step of a pilot run, with the particles where they are now.

    Args:
        coarse: The scene in coarser cells.
        summary: Summary of the scene's particles.
        simulation: The coarse simulation.
        seconds: Processor time of a step [s].
    """
    x, _, owner = _bodies_of(simulation)
    count = np.bincount(owner, minlength=len(simulation.plan.count))
    proximity = measure_proximity(coarse, np.split(x, np.cumsum(count)[:-1]), summary.colliders)
    plan = simulation.plan.with_particles(tuple(count.tolist()), proximity)
    fluid, elastic = (
        step_ns(coarse, plan, Throughput(*pace, "")) for pace in ((1.0, 0.0), (0.0, 1.0))
    )
    return CoarseStep(seconds, fluid, elastic)


def _snapshot(
    scene: Scene, plan: Plan, summary: ParticleSummary, simulation: Simulation, steps: float,
    step: CoarseStep,
) -> Snapshot:  # fmt: skip
    """Return a snapshot of a simulation, converted to the cells and particle counts of the scene.

    Args:
        scene: The scene.
        plan: Its plan.
        summary: Summary of its particles.
        simulation: The coarse simulation.
        steps: Steps since the last snapshot, in the scene's own cells.
        step: Mean step of the coarse simulation since then.
    """
    x, volume, owner = _bodies_of(simulation)
    offset = _half_width(scene, x, owner, volume)
    counts = np.bincount(owner, minlength=len(plan.count))
    x = x[:, None] + offset[:, None, None] * CORNERS
    x = np.clip(x, 0.0, np.nextafter(scene.domain.size, 0.0))
    positions = [part.reshape(-1, 3) for part in np.split(x, np.cumsum(counts)[:-1])]
    rows = zip(counts, simulation.plan.count, plan.count, strict=True)
    count = tuple(
        round(n / max(coarse_count, 1) * scene_count) for n, coarse_count, scene_count in rows
    )
    proximity = measure_proximity(scene, positions, summary.colliders)
    return Snapshot(simulation.time, steps, count, proximity, step)


def _half_width(scene: Scene, x: np.ndarray, owner: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Return the distance [m] from coarse particles to the finer ones in their place, shape (n,).

    Args:
        scene: The scene, with the cells whose blocks are counted.
        x: Positions of the coarse particles, shape (n, 3) [m].
        owner: Object of each, shape (n,).
        volume: Rest volume of each, shape (n,) [m3].
    """
    rows = np.column_stack([owner, blocks_at(x, scene.domain.cell)])
    _, row = np.unique(rows, axis=0, return_inverse=True)
    fill = np.bincount(row.ravel(), volume) / (BLOCK_EDGE * scene.domain.cell) ** 3
    is_scattered = fill[row.ravel()] < SCATTERED_FILL
    return np.where(is_scattered, SCATTERED_HALF_WIDTH, HALF_WIDTH) * np.cbrt(volume)
