"""How even a scene's work would be on many ranks: one rank computes, the cuts of others are
followed.

Particles and blocks do not depend on the ranks, so a run on one tells which pieces any number of
ranks would own at each sort, with the solver's own cuts and its own rule for when to move them.
"""

from pathlib import Path

import numpy as np

from ..domain import balance
from ..domain.balance import by_block, cuts, imbalance, loads, owners, predicted
from ..domain.ranks import Alone
from ..prepare.build import build
from ..scene.reader import load
from ..solver.prepared import known_of, plan_for
from ..solver.step import Simulation


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
        """Particles were sorted, `steps` after the last time; see balance.by_block."""
        if self.cut is None:
            self.cut = self.first = cuts(*self._offers(keys, work, count)[:2], self.ranks, None)
        elif balance.worth(loads(keys, work, self.cut), steps):
            new = balance.recut(*self._offers(keys, work, count), self.ranks, self.cut, steps)
            self.taken += new is not self.cut
            self.moved += int(count[owners(keys, new) != owners(keys, self.cut)].sum())
            self.cut = new
        self.moving.append(imbalance(loads(keys, work, self.cut)))
        self.fixed.append(imbalance(loads(keys, work, self.first)))

    def _offers(self, *blocks: np.ndarray) -> np.ndarray:
        """Runs of blocks that all ranks together offer to cut between."""
        edge = np.searchsorted(blocks[0], [] if self.cut is None else self.cut)
        pieces = zip(*(np.split(one, edge) for one in blocks), strict=True)
        before, total, found = 0, int(blocks[1].sum()), []
        for piece in pieces:
            found.append(balance.offers(*piece, before, total, self.ranks))
            before += int(piece[1].sum())
        return np.concatenate(found).T


def follow(path: Path, overrides: list[str], ranks: list[int], seconds: float, say) -> dict:
    """Run the scene for `seconds` of its time; what each number of ranks would have seen.

    Raises SceneError.
    """
    scene = load(path, overrides)
    made = build(scene)
    plan = plan_for(scene, known_of(scene, made))
    simulation = Simulation(plan, Alone(), made.colliders)
    ids = np.arange(len(made.x))
    simulation.put(made.x, made.v0, made.vol0, ids, made.object, surface=made.surface0)
    end = min(seconds or plan.times[-1], float(plan.times[-1]))
    followed = [Followed(n) for n in ranks]
    costs = np.array([group.cost for group in plan.groups])
    weights, steps = [], [0]
    sorts = 0
    while simulation.time < end:
        if simulation.sorts > sorts:
            sorts = simulation.sorts
            found = simulation.census
            work = predicted(found.particles, costs[found.group])
            for one in followed:
                one.sorted(*by_block(found.key, work, found.particles), steps[-1])
            weights.append(0)
            say(f"{simulation.time:.4f} of {end:.4f} s, sort {sorts}")
        before = simulation.sorted_at
        simulation.advance(min(simulation.bound(), plan.fixed_dt or np.inf))
        weights[-1] += 1
        if simulation.sorted_at != before:
            steps.append(simulation.sorted_at - before)
    return {
        "title": scene.title or path.name,
        "particles": plan.particles,
        "materials": len({group.material for group in plan.groups}),
        "blocks": len(np.unique(simulation.census.key)),
        "steps": simulation.step,
        "time": simulation.time,
        "sorts": simulation.sorts,
        "rows": [_row(one, np.array(weights), plan.particles) for one in followed],
    }


def _row(one: Followed, weights: np.ndarray, particles: int) -> dict:
    moving, fixed = np.array(one.moving), np.array(one.fixed)
    return {
        "ranks": one.ranks,
        "mean": float(np.average(moving, weights=weights)),
        "worst": float(moving.max()),
        "fixed_mean": float(np.average(fixed, weights=weights)),
        "fixed_worst": float(fixed.max()),
        "taken": one.taken,
        "moved": one.moved / particles,
    }


def text(found: dict) -> str:
    """The result as a table."""
    lines = [
        f"{found['title']}: {found['particles']:,} particles of {found['materials']} material(s) in"
        f" {found['blocks']:,} blocks, {found['steps']:,} steps to {found['time']:.3g} s,"
        f" {found['sorts']} sorts",
        "largest over mean work, in the mean over all steps and at worst:",
        "   ranks   rebalanced: mean   worst   never: mean   worst   new cuts   particles moved",
    ]
    for row in found["rows"]:
        lines.append(
            f"{row['ranks']:8d} {row['mean']:18.3f} {row['worst']:7.3f} {row['fixed_mean']:13.3f}"
            f" {row['fixed_worst']:7.3f} {row['taken']:10d} {row['moved']:15.2f} x"
        )
    return "\n".join(lines)
