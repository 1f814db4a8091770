"""What a script or a notebook uses: load, plan, run, read. See docs/api.md."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .domain.ranks import Alone, world
from .output.read import RunFiles as read
from .planning.plan import Plan
from .scene import reader
from .scene.scene import Scene
from .tables import SceneError

__all__ = ["Run", "SceneError", "load", "plan", "read", "run"]


def load(
    path: str | Path,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    text: str | None = None,
) -> Scene:
    """Read a scene. Raises SceneError with all that is wrong with it.

    overrides: {"domain.cell": "1 cm"}, or ["domain.cell=1 cm"] as for --set. text: the scene
    itself; then nothing is read from `path`, which names it in messages, and other files are looked
    for in the folder of `path`.
    """
    if isinstance(overrides, Mapping):
        overrides = [f"{key}={_toml(value)}" for key, value in overrides.items()]
    return reader.load(path, tuple(overrides), text)


def _toml(value: Any) -> str:
    """A value as --set takes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(map(_quoted, value))}]"
    return str(value)


def _quoted(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else _toml(value)


def plan(scene: Scene, ranks: Alone | None = None) -> Plan:
    """What a scene needs: particles, phases, memory, time step. Collective; makes the particles and
    lets them go. `vgmpi.plan(scene).bytes()`."""
    from .solver.prepared import plan_for, prepare

    return plan_for(scene, prepare(scene, ranks or Alone(), None))


class Run:
    """A run, at each frame and at its end.

    code: 0 done, 3 blew up, 75 stopped; None while it goes on.
    """

    def __init__(self, inner):
        self._inner = inner
        self.code: int | None = None

    @property
    def simulation(self):
        """The solver's state; see vgmpi/solver/step.py."""
        return self._inner.simulation

    @property
    def time(self) -> float:
        """[s]"""
        return self._inner.simulation.time

    @property
    def step(self) -> int:
        """Time steps made."""
        return self._inner.simulation.step

    @property
    def frame(self) -> int:
        """Number of this frame in on_frame, elsewhere of the next one."""
        return self._inner.frame

    @property
    def ledger(self) -> list[dict]:
        """Mass, momentum and energy of every phase at this frame; empty but on rank 0."""
        return self._inner.latest

    @property
    def probes(self) -> dict[str, list[dict]]:
        """Rows of every probe so far, by its name; empty but on rank 0."""
        return self._inner.probes.rows

    def arrays(self, *names: str) -> dict[str, np.ndarray]:
        """Particles of all ranks in the order of their ids, on every rank. Collective: all ranks
        ask for the same.

        names: x (n, 3) [m], v (n, 3) [m/s], C (n, 9) [1/s], vol0 (n,) [m3], J, object and id (n,).
        """
        from .solver.state import by_id

        return dict(zip(names, by_id(self.simulation, *names), strict=True))

    def array(self, name: str) -> np.ndarray:
        """One of `arrays`."""
        return self.arrays(name)[name]


def run(
    scene: Scene,
    folder: str | Path | None = None,
    on_step: Callable[[Run], None] | None = None,
    on_frame: Callable[[Run], None] | None = None,
    ranks: Alone | None = None,
    threads: int = 1,
    engine: str = "cpu",
    overwrite: bool = False,
) -> Run:
    """Run a scene to its end, from its start.

    folder: where files go; None: nothing is written. on_step, on_frame: called with the Run after
    every step and at every frame, the first at time 0. ranks: `vgmpi.domain.ranks.world()` under
    mpirun, which is the default; all ranks call everything. engine: "cpu", "cuda": a card for each
    rank (docs/cuda.md), or "numpy": slow, on one rank and one thread, for comparison. overwrite:
    replace a run that lies in the folder. Raises SceneError, StoreError, output.owner.FolderError
    where the folder is another run's, and a ValueError where engine, ranks and threads do not go
    together; a blow-up is code 3, but raised
    (BlowUp) where it comes before the first frame.
    """
    from .solver import run as runs

    options = runs.Options(
        None if folder is None else Path(folder), threads, engine, overwrite=overwrite
    )
    with runs.started(scene, ranks or world(), options) as inner:
        this = Run(inner)
        if on_step is not None:
            options.listeners.append(lambda simulation: on_step(this))
        if on_frame is not None:
            options.watchers.append(lambda run: on_frame(this))
        this.code = inner.go()
    return this
