"""The loads of a run: their particles on this rank, and the push of each step."""

import math

import numpy as np

from ..domain.ranks import Alone
from ..domain.state import Group
from ..kernels.push import push
from ..planning.plan import Plan
from ..prepare.loaded import Loaded
from ..scene.motion import turning


class Pushes:
    """Pushes this rank's loaded particles. `find` after every sort, `push` before every transfer to
    the grid; the same bits on any number of ranks, since each particle is pushed by itself, or
    about a middle that is summed in the order of the segments.
    """

    def __init__(self, loads: list[Loaded], plan: Plan, ranks: Alone):
        self.loads, self.plan, self.ranks = loads, plan, ranks
        self.places: list[list[np.ndarray]] = []  # of each load, in each group
        self.dv = np.zeros(3, plan.real)

    def find(self, groups: list[Group]) -> None:
        """Where the particles of each load are now."""
        there = [(group, group.index()) for group in groups]
        self.places = [
            [at[within(group.ids[at], load.ids)] for group, at in there] for load in self.loads
        ]

    def push(self, groups: list[Group], time: float, end: float, dt: float) -> float:
        """Velocities change by what the loads do in a step of dt [s] from `time` to `end` [s].
        Returns by how much at the most [m/s], the same on all ranks. Collective."""
        most = 0.0
        for loaded, places in zip(self.loads, self.places, strict=True):
            amount = loaded.load.amount(time, end, dt)
            if amount == 0.0:
                continue
            if loaded.load.spin is not None:
                most += self._spin(loaded, groups, places)
                continue
            fastest = 0.0
            for group, at in zip(groups, places, strict=True):
                self.dv[:] = [amount * a for a in strength(loaded, group.plan.density)]
                push(group.f, at, self.dv)
                fastest = max(fastest, float(np.abs(self.dv).max()))
            most += fastest
        return most

    def _spin(self, loaded: Loaded, groups: list[Group], places: list[np.ndarray]) -> float:
        """Turn particles about their centre of mass. Returns as `push`."""
        x = [group.positions_at(at) for group, at in zip(groups, places, strict=True)]
        middle = self._middle(groups, places, x)
        spin = loaded.load.spin or (0.0, 0.0, 0.0)
        turns = np.array(turning(spin))
        fastest = 0.0
        for group, at, here in zip(groups, places, x, strict=True):
            dv = np.cross(spin, here - middle).astype(group.f.dtype)
            group.put("v", at, group.get("v", at) + dv)
            if self.plan.affine:
                group.put("C", at, group.get("C", at) + turns.astype(group.f.dtype))
            fastest = max(fastest, float(np.abs(dv).max(initial=0.0)))
        return float(self.ranks.max(np.array([fastest]))[0])

    def _middle(self, groups: list[Group], places: list, x: list) -> np.ndarray:
        """Centre of mass (3,) [m] of particles on all ranks, summed segment by segment in the order
        of the segments' keys."""
        total = np.zeros(4)
        for group, at, here in zip(groups, places, x, strict=True):
            mass = group.plan.density * group.get("vol0", at).astype(float)
            rows = np.zeros((len(group.start), 4))
            np.add.at(rows, group.segment_of(at), np.concatenate([mass, mass * here], axis=1))
            found = self.ranks.root_rows(rows)
            if found is not None:
                total += found.sum(0)
        total = self.ranks.bcast(total)
        return total[1:] / total[0]

    def soon(self, groups: list[Group], time: float, dt: float) -> float:
        """By how much velocities change at once [m/s], at the most, within dt [s]; the same on all
        ranks."""
        found = 0.0
        for loaded in self.loads:
            if not (loaded.load.at_once and time <= loaded.load.after < time + dt):
                continue
            if loaded.load.spin is not None:
                found += math.hypot(*loaded.load.spin) * self.plan.dx * math.hypot(*self.plan.cells)
            else:
                found += max(math.hypot(*strength(loaded, g.plan.density)) for g in groups)
        return found

    def impulse(self, t0: float, t1: float) -> np.ndarray:
        """What all loads give between two times [s], of all ranks: (3,) [N s]."""
        given = np.zeros(3)
        for loaded in self.loads:
            given += loaded.load.amount(t0, t1, t1 - t0) * np.array(loaded.total)
        return given


def strength(loaded: Loaded, density: float) -> tuple[float, float, float]:
    """[m/s2], or [m/s] at once, at full strength, of particles of this density [kg/m3]."""
    alike = loaded.load.acceleration or loaded.load.velocity
    if alike is not None:
        return alike
    x, y, z = loaded.density
    return x / density, y / density, z / density


def within(ids: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Whether ids (n,) lie in one of the runs (m, 2): (n,)."""
    run = np.searchsorted(runs[:, 0], ids, side="right") - 1
    return (run >= 0) & (ids <= runs[run, 1])
