"""The loads of a run: their particles on this rank, and the push of each step."""

import numpy as np

from ..domain.state import Group
from ..kernels.push import push
from ..prepare.loaded import Loaded


class Pushes:
    """Pushes this rank's loaded particles. `find` after every sort, `push` before every transfer to
    the grid; the same bits on any number of ranks, since each particle is pushed by itself.
    """

    def __init__(self, loads: list[Loaded], real: np.dtype):
        self.loads = loads
        self.places: list[list[np.ndarray]] = []  # of each load, in each group
        self.dv = np.zeros(3, real)

    def find(self, groups: list[Group]) -> None:
        """Where the particles of each load are now."""
        there = [(group, group.index()) for group in groups]
        self.places = [
            [at[within(group.ids[at], load.ids)] for group, at in there] for load in self.loads
        ]

    def push(self, groups: list[Group], time: float, dt: float) -> float:
        """Velocities change by what the loads do in a step of dt [s] that begins at `time` [s].
        Returns by how much at the most [m/s], the same on all ranks."""
        most = 0.0
        for loaded, places in zip(self.loads, self.places, strict=True):
            share = loaded.load.share(time, time + dt)
            if share == 0.0:
                continue
            fastest = 0.0
            for group, at in zip(groups, places, strict=True):
                self.dv[:] = [dt * share * a for a in acceleration(loaded, group.plan.density)]
                push(group.f, at, self.dv)
                fastest = max(fastest, float(np.abs(self.dv).max()))
            most += fastest
        return most

    def impulse(self, t0: float, t1: float) -> np.ndarray:
        """What all loads give between two times [s], of all ranks: (3,) [N s]."""
        given = np.zeros(3)
        for loaded in self.loads:
            given += (t1 - t0) * loaded.load.share(t0, t1) * np.array(loaded.total)
        return given


def acceleration(loaded: Loaded, density: float) -> tuple[float, float, float]:
    """[m/s2] at full strength, of particles of this density [kg/m3]."""
    if loaded.load.acceleration is not None:
        return loaded.load.acceleration
    x, y, z = loaded.density
    return x / density, y / density, z / density


def within(ids: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Whether ids (n,) lie in one of the runs (m, 2): (n,)."""
    run = np.searchsorted(runs[:, 0], ids, side="right") - 1
    return (run >= 0) & (ids <= runs[run, 1])
