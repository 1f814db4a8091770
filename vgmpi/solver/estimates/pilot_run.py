"""Pilot run in coarser cells, for the cost estimate of --plan.

The cost of a step depends on where particles are: particles near other bodies cost more, and so
do blocks that are not full. A run in cells 2.5 times as large takes about a fortieth of the work.
"""

import contextlib
import logging
import math
import time
from collections.abc import Iterator

import numpy as np

from vgmpi.parallel.block_lattice import BLOCK_EDGE
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.feature_costs import step_ns
from vgmpi.planning.cost.pilot_result import STEP_SECONDS, PilotRun, Snapshot
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load_again
from vgmpi.scene.scene import Scene
from vgmpi.solver.initial_particles import ParticleSummary
from vgmpi.solver.run import Options, Runner, prepared_run
from vgmpi.solver.simulation import BlowUp, Simulation

from .measure_proximity import blocks_at, measure_proximity

log = logging.getLogger("vgmpi")

COARSENING_FACTORS = (2.5, 2.0, 1.5)  # [scene cells] cell sizes; the first that works is taken
MIN_CELLS = 4  # [cells] least number along the shortest edge
# [particle edges] distance from a particle's center to its finer ones, in blocks that are less than
# half full farther: coarse particles scatter over fewer blocks than fine ones do
HALF_WIDTH, SCATTERED_HALF_WIDTH, SCATTERED_FILL = 0.4, 1.5, 0.5
CORNERS = np.stack(np.meshgrid(*((-1.0, 1.0),) * 3, indexing="ij"), -1).reshape(1, 8, 3)
SNAPSHOTS = 24  # largest number of snapshots


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
    for count in _cell_counts(scene):
        try:
            coarse = _coarsened(scene, count)  # what fits the scene's cells may not fit these
            log.log(level, "pilot run in cells of %.4g m", coarse.domain.cell)
            with _without_warnings():
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
def _without_warnings() -> Iterator[None]:
    """Leave out warnings, which would be about the coarser cells."""
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def pilot_seconds(scene: Scene, plan: Plan, pace: Throughput) -> float:
    """Return the time [s] that a pilot run takes on this core, infinity if none is possible."""
    counts = _cell_counts(scene)
    if not counts:
        return math.inf
    ratio = counts[0] / max(scene.domain.cells)  # [scene cells per coarse cell]
    dt = plan.fixed_dt or time_step_bounds(scene, plan)[0][0]
    steps = ratio * float(plan.times[-1]) / dt
    return steps * (1e-9 * step_ns(scene, plan, pace, ratio) + STEP_SECONDS)


def _cell_counts(scene: Scene) -> list[int]:
    """Return coarser cell counts of the longest edge, ascending, that divide every edge."""
    cells = scene.domain.cells
    unit = max(cells) // math.gcd(*cells)
    candidates = {unit * round(max(cells) / (unit * factor)) for factor in COARSENING_FACTORS}
    minimum = MIN_CELLS * max(cells) / min(cells)
    return sorted(n for n in candidates if minimum <= n < max(cells))


def _coarsened(scene: Scene, count: int) -> Scene:
    """Return the scene with `count` cells along the longest edge."""
    cell = max(scene.domain.size) / count
    overrides = [f"domain.cell={cell!r}"]
    if scene.time.dt:
        overrides.append(f"time.dt={scene.time.dt * cell / scene.domain.cell!r}")
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
    """
    start, snapshots = time.monotonic(), []
    with prepared_run(coarse, SerialCommunicator(), Options(None)) as run:
        step_ratio = time_step_bounds(coarse, run.plan)[0][0] / time_step_bounds(scene, plan)[0][0]
        if plan.fixed_dt and run.plan.fixed_dt:
            step_ratio = run.plan.fixed_dt / plan.fixed_dt
        interval, steps_before = math.ceil(len(run.times) / SNAPSHOTS), 0
        first_second = time.process_time()

        def look(run: Runner) -> None:
            """Take a snapshot if the frame is due."""
            nonlocal steps_before
            if time.process_time() - first_second > max_seconds:
                raise PilotTimeout
            if run.frame and (run.frame % interval == 0 or run.frame == len(run.times) - 1):
                steps, steps_before = run.simulation.step - steps_before, run.simulation.step
                snapshots.append(
                    _snapshot(scene, plan, summary, run.simulation, step_ratio * steps)
                )

        run.options.watchers.append(look)
        run.run()
    return PilotRun(coarse.domain.cell, time.monotonic() - start, tuple(snapshots))


def _snapshot(
    scene: Scene, plan: Plan, summary: ParticleSummary, simulation: Simulation, steps: float
) -> Snapshot:
    """Return a snapshot of a simulation, converted to the cells and particle counts of the scene.

    Args:
        scene: The scene.
        plan: Its plan.
        summary: Summary of its particles.
        simulation: The coarse simulation.
        steps: Steps since the last snapshot, in the scene's own cells.
    """
    groups = simulation.groups
    owner = np.concatenate([simulation.object_of(g.ids[g.index()]) for g in groups])
    x = np.concatenate([g.positions() for g in groups])
    volume = np.concatenate([g.get("vol0", g.index())[:, 0] for g in groups])
    offset = _half_width(scene, x, owner, volume)
    order = np.argsort(owner, kind="stable")
    counts = np.bincount(owner, minlength=len(plan.count))
    x = x[order, None] + offset[order, None, None] * CORNERS
    x = np.clip(x, 0.0, np.nextafter(scene.domain.size, 0.0))
    positions = [part.reshape(-1, 3) for part in np.split(x, np.cumsum(counts)[:-1])]
    rows = zip(counts, simulation.plan.count, plan.count, strict=True)
    count = tuple(
        round(n / max(coarse_count, 1) * scene_count) for n, coarse_count, scene_count in rows
    )
    return Snapshot(
        simulation.time, steps, count, measure_proximity(scene, positions, summary.colliders)
    )


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
