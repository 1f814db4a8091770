"""How even a scene's work would be on many ranks: one rank computes, the cuts of others are
followed.

Particles and blocks do not depend on the ranks, so a run on one tells which pieces any number of
ranks would own at each sort, with the solver's own cuts and its own rule for when to move them.
"""

from pathlib import Path

import numpy as np

from vgmpi.parallel import load_balance
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.load_balance import (
    by_block,
    imbalance,
    loads,
    owners,
    partition,
    predicted_work,
)
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.simulation import Simulation


class Followed:
    """One number of ranks: its cuts as they move, and the first ones that never do."""

    def __init__(self, ranks: int):
        self.ranks = ranks
        self.cut = self.first = None
        self.moving: list[float] = []  # largest over mean work from each sort to the next
        self.fixed: list[float] = []
        self.moved = 0  # particles that changed rank because a cut did
        self.taken = 0  # times new cuts were taken

    def sorted(self, keys: np.ndarray, work: np.ndarray, count: np.ndarray, steps: int) -> None:
        """Account for a particle sort; see balance.by_block.

        Args:
            keys: Keys of the blocks.
            work: Work of each block.
            count: Particles of each block.
            steps: Steps since the previous sort.
        """
        if self.cut is None:
            self.cut = self.first = partition(
                *self._offers(keys, work, count)[:2], self.ranks, None
            )
        elif load_balance.should_rebalance(loads(keys, work, self.cut), steps):
            new = load_balance.rebalance(
                *self._offers(keys, work, count), self.ranks, self.cut, steps
            )
            self.taken += new is not self.cut
            self.moved += int(count[owners(keys, new) != owners(keys, self.cut)].sum())
            self.cut = new
        self.moving.append(imbalance(loads(keys, work, self.cut)))
        self.fixed.append(imbalance(loads(keys, work, self.first)))

    def _offers(self, *blocks: np.ndarray) -> np.ndarray:
        """Runs of blocks that all ranks together offer to cut between."""
        edge = np.searchsorted(blocks[0], [] if self.cut is None else self.cut)
        pieces = zip(*(np.split(block_values, edge) for block_values in blocks), strict=True)
        before, total, candidates = 0, int(blocks[1].sum()), []
        for piece in pieces:
            candidates.append(load_balance.candidate_cuts(*piece, before, total, self.ranks))
            before += int(piece[1].sum())
        return np.concatenate(candidates).T


def follow(path: Path, overrides: list[str], ranks: list[int], seconds: float, say) -> dict:
    """Run the scene for some time and follow the balance for each number of ranks.

    Args:
        path: Scene file.
        overrides: Overrides as for a run.
        ranks: Numbers of ranks.
        seconds: Time of the scene [s], 0 for all of it.
        say: Called with a progress line.

    Raises:
        SceneError: The scene is invalid.
    """
    scene = load(path, overrides)
    bodies = build_scene(scene)
    plan = plan_for(scene, known_of(scene, bodies))
    simulation = Simulation(plan, SerialCommunicator(), bodies.colliders)
    ids = np.arange(len(bodies.x))
    simulation.put(bodies.x, bodies.v0, bodies.vol0, ids, bodies.object, surface=bodies.surface0)
    end = min(seconds or plan.times[-1], float(plan.times[-1]))
    followed = [Followed(n) for n in ranks]
    costs = np.array([group.cost for group in plan.groups])
    weights, steps = [], [0]
    sorts = 0
    while simulation.time < end:
        if simulation.sorts > sorts:
            sorts = simulation.sorts
            blocks = simulation.exchange.census
            work = predicted_work(blocks.particles, costs[blocks.group])
            for entry in followed:
                entry.sorted(*by_block(blocks.key, work, blocks.particles), steps[-1])
            weights.append(0)
            say(f"{simulation.time:.4f} of {end:.4f} s, sort {sorts}")
        before = simulation.sorted_at
        simulation.advance(min(simulation.bound(), plan.time_step.fixed or np.inf))
        weights[-1] += 1
        if simulation.sorted_at != before:
            steps.append(simulation.sorted_at - before)
    return {
        "title": scene.title or path.name,
        "particles": plan.particles,
        "materials": len({group.material for group in plan.groups}),
        "blocks": len(np.unique(simulation.exchange.census.key)),
        "steps": simulation.step,
        "time": simulation.time,
        "sorts": simulation.sorts,
        "rows": [_row(entry, np.array(weights), plan.particles) for entry in followed],
    }


def _row(entry: Followed, weights: np.ndarray, particles: int) -> dict:
    moving, fixed = np.array(entry.moving), np.array(entry.fixed)
    return {
        "ranks": entry.ranks,
        "mean": float(np.average(moving, weights=weights)),
        "worst": float(moving.max()),
        "fixed_mean": float(np.average(fixed, weights=weights)),
        "fixed_worst": float(fixed.max()),
        "taken": entry.taken,
        "moved": entry.moved / particles,
    }


def text(study: dict) -> str:
    """The result as a table."""
    lines = [
        f"{study['title']}: {study['particles']:,} particles of {study['materials']} material(s) in"
        f" {study['blocks']:,} blocks, {study['steps']:,} steps to {study['time']:.3g} s,"
        f" {study['sorts']} sorts",
        "largest over mean work, in the mean over all steps and at worst:",
        "   ranks   rebalanced: mean   worst   never: mean   worst   new cuts   particles moved",
    ]
    for row in study["rows"]:
        lines.append(
            f"{row['ranks']:8d} {row['mean']:18.3f} {row['worst']:7.3f} {row['fixed_mean']:13.3f}"
            f" {row['fixed_worst']:7.3f} {row['taken']:10d} {row['moved']:15.2f} x"
        )
    return "\n".join(lines)
