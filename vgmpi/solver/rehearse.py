"""A scene played in coarser cells first, for --plan: where its particles go, and in how many steps.

What a step costs depends on where particles are: those near other bodies cost more, and so do
blocks that are not full. A run in cells COARSER times as large takes some fortieth of the work.
"""

import logging
import math
import time

import numpy as np

from ..domain.ranks import Alone
from ..planning.plan import Plan, fastest
from ..planning.rehearsal import Rehearsal, Standing
from ..scene.reader import load
from ..scene.scene import Scene
from ..tables import SceneError
from .prepared import Known
from .run import Options, Runner, started
from .step import BlowUp, Simulation
from .surroundings import standing

log = logging.getLogger("vgmpi")

COARSER = (2.5, 2.0, 1.5)  # times the scene's cells: the first in which it can be played
FEWEST = 4  # cells along the shortest edge
WIDE = 0.4  # of a particle's edge, from its middle to where its finer ones may be
CORNERS = np.stack(np.meshgrid(*((-1.0, 1.0),) * 3, indexing="ij"), -1).reshape(1, 8, 3)
MOMENTS = 24  # at which it is looked at, at the most


def rehearse(scene: Scene, plan: Plan, known: Known) -> Rehearsal | None:
    """Play the scene on this rank alone, and write nothing. None, and a line that says why, where
    it can be played in no coarser cells."""
    why = "it has too few cells"
    for count in _counts(scene):
        coarse = _coarser(scene, count)
        log.info("rehearsing in cells of %.4g m", coarse.domain.cell)
        try:
            return _played(scene, plan, known, coarse)
        except SceneError as error:
            why = error.lines[0]
        except BlowUp as error:
            why = str(error)
    log.warning("cannot be rehearsed in coarser cells: %s", why)
    return None


def _counts(scene: Scene) -> list[int]:
    """Cells along the longest edge, of which every edge is a whole number, from few to many."""
    cells = scene.domain.cells
    unit = max(cells) // math.gcd(*cells)
    found = {unit * round(max(cells) / (unit * factor)) for factor in COARSER}
    least = FEWEST * max(cells) / min(cells)
    return sorted(n for n in found if least <= n < max(cells))


def _coarser(scene: Scene, count: int) -> Scene:
    """The scene with so many cells along the longest edge."""
    cell = max(scene.domain.size) / count
    more = [f"domain.cell={cell!r}"]
    if scene.time.dt:
        more.append(f"time.dt={scene.time.dt * cell / scene.domain.cell!r}")
    return load(scene.path, (*scene.overrides, *more), scene.text)


def _played(scene: Scene, plan: Plan, known: Known, coarse: Scene) -> Rehearsal:
    began, moments = time.monotonic(), []
    with started(coarse, Alone(), Options(None)) as run:
        finer = fastest(coarse, run.plan)[0][0] / fastest(scene, plan)[0][0]
        if plan.fixed_dt and run.plan.fixed_dt:
            finer = run.plan.fixed_dt / plan.fixed_dt
        every, done = math.ceil(len(run.times) / MOMENTS), 0

        def look(run: Runner) -> None:
            nonlocal done
            if run.frame and (run.frame % every == 0 or run.frame == len(run.times) - 1):
                steps, done = run.simulation.step - done, run.simulation.step
                moments.append(_stands(scene, plan, known, run.simulation, finer * steps))

        run.options.watchers.append(look)
        run.go()
    return Rehearsal(coarse.domain.cell, time.monotonic() - began, tuple(moments))


def _stands(
    scene: Scene, plan: Plan, known: Known, simulation: Simulation, steps: float
) -> Standing:
    groups = simulation.groups
    thing = np.concatenate([simulation.object_of(g.ids[g.index()]) for g in groups])
    x = np.concatenate([g.positions() for g in groups])
    wide = WIDE * np.cbrt(np.concatenate([g.get("vol0", g.index())[:, 0] for g in groups]))
    order = np.argsort(thing, kind="stable")
    there = np.bincount(thing, minlength=len(plan.count))
    x = x[order, None] + wide[order, None, None] * CORNERS
    apart = [of.reshape(-1, 3) for of in np.split(x, np.cumsum(there)[:-1])]
    share = zip(there, simulation.plan.count, plan.count, strict=True)
    count = tuple(round(n / max(of, 1) * own) for n, of, own in share)
    return Standing(simulation.time, steps, count, standing(scene, apart, known.colliders))
