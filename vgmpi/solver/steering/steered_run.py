"""A run as a script sees and steers it."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from vgmpi.runtime.message_text import did_you_mean

# names of the arrays of a run, as in its files, and those that the solver has for them
ARRAYS = {
    "id": "id", "positions": "x", "velocity": "v", "J": "J", "F": "F", "stress": "stress",
    "pressure": "pressure", "strain": "strain", "object": "object", "phase": "phase",
    "vol0": "vol0", "C": "C",
}  # fmt: skip


class Run:
    """State of a run, at each frame, after each step and at its end.

    `vgmpi.run` passes it to `on_frame` and returns it. `vgmpi.simulate` gives it to a loop over the
    steps.
    """

    def __init__(self, inner):
        """Wrap a runner of vgmpi/solver/run.py."""
        self._inner, self._steps = inner, inner.steps()

    def __repr__(self) -> str:
        state = {None: "going on", 0: "done", 3: "blew up", 75: "stopped"}[self.code]
        return f"<Run {state} at {self.time:.4g} s, step {self.step}, frame {self.frame}>"

    def __iter__(self) -> Iterator[int]:
        """Return this run, which makes its steps one by one."""
        return self

    def __next__(self) -> int:
        """Make the next step and return the number of steps made. Collective."""
        next(self._steps)
        return self.step

    @property
    def code(self) -> int | None:
        """Exit code as of the command: 0 done, 3 blew up, 75 stopped; None while it goes on."""
        return self._inner.code

    @property
    def simulation(self):
        """State of the solver, see vgmpi/solver/simulation.py."""
        return self._inner.simulation

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._inner.simulation.time

    @property
    def step(self) -> int:
        """Number of time steps made."""
        return self._inner.simulation.step

    @property
    def frame(self) -> int:
        """Number of the present frame within `on_frame`, elsewhere of the next frame."""
        return self._inner.frame

    @property
    def is_at_frame(self) -> bool:
        """Return whether the present time is that of a frame: steps end at the times of frames."""
        return self._inner.is_at_frame

    @property
    def ledger(self) -> list[dict]:
        """Mass, momentum and energy of each phase at this frame; empty on ranks other than 0."""
        return self._inner.latest_conservation

    @property
    def probes(self) -> dict[str, list[dict]]:
        """Rows of every probe so far, by the probe's name; empty on ranks other than 0.

        With an output folder they are read from its tables, each time anew.
        """
        return self._inner.probes.all_rows()

    def arrays(self, *names: str) -> dict[str, np.ndarray]:
        """Return arrays of all particles, in the order of their ids, on every rank.

        They are copies in double precision or int64, and read-only: to write one would change
        nothing of the run. Collective: all ranks must ask for the same names.

        Args:
            names: Names as in the files of a run: id (n,), positions (n, 3) [m], velocity
                (n, 3) [m/s], J (n,), F (n, 9), stress (n, 6) [Pa], pressure (n,) [Pa],
                strain (n, 6), object (n,), phase (n,), vol0 (n,) [m3] and C (n, 9) [1/s].

        Returns:
            The arrays by name.

        Raises:
            KeyError: If there is no array of a name.

        Example:
            ```python
            state = run.arrays("positions", "velocity")
            print(state["velocity"].mean(axis=0))  # [m/s]
            ```
        """
        from vgmpi.solver.restart.state_io import by_id

        for name in names:
            if name not in ARRAYS:
                hint = did_you_mean(name, ARRAYS)
                raise KeyError(f"there is no array '{name}'{hint}; there are {', '.join(ARRAYS)}")
        arrays = by_id(self.simulation, *(ARRAYS[name] for name in names))
        for array in arrays:
            array.flags.writeable = False
        return dict(zip(names, arrays, strict=True))

    def array(self, name: str) -> np.ndarray:
        """Return one of the arrays that `arrays` offers. Collective.

        Example:
            ```python
            height = run.array("positions")[:, 2].max()  # [m]
            ```
        """
        return self.arrays(name)[name]

    def ids(self, name: str) -> np.ndarray:
        """Return the ids (n,) of the present particles of an object or particle source. Collective.

        Raises:
            KeyError: If the scene has no object or particle source of that name.

        Example:
            ```python
            ball = run.ids("ball")
            ```
        """
        names = [entity.name for entity in self._inner.scene.entities]
        if name not in names:
            hint = did_you_mean(name, names)
            raise KeyError(f"there is no object '{name}'{hint}; there are {', '.join(names)}")
        arrays = self.arrays("id", "object")
        return arrays["id"][arrays["object"] == names.index(name)]

    def set(self, name: str, ids: np.ndarray, values: np.ndarray) -> None:
        """Set the velocity of particles, before the next step. Collective.

        Every rank gives the same ids and values. The result has the same bits on any number of
        ranks. The next step is as short as the new velocities require.

        Args:
            name: `"velocity"` [m/s], or `"C"`, the gradient of the velocity within a particle's
                neighborhood [1/s], row by row, which a new velocity does not change.
            ids: Ids of the particles, shape (n,).
            values: Values, shape (n, 3) or (3,) for all; of C (n, 9) or (9,).

        Raises:
            ValueError: On all ranks, for particles that are not there, that are given twice or that
                move as prescribed, for wrong shapes and for values that are not finite. Nothing is
                changed then.

        Example:
            ```python
            sim.set("velocity", sim.ids("ball"), [0, 0, 1.5])
            ```
        """
        self._changes().set_values(name, ids, values)

    def add_force(self, ids: np.ndarray, forces: np.ndarray) -> None:
        """Add forces on particles, which act during the next step and then no longer. Collective.

        Forces of several calls add up. Before the step, a force f changes the velocity of a
        particle of mass m by f dt / m, which the particle hands to its neighborhood: momentum
        grows by the sum of f dt. Every rank gives the same ids and forces.

        Args:
            ids: Ids of the particles, shape (n,).
            forces: Forces, shape (n, 3), or (3,) for each of them [N].

        Raises:
            ValueError: On all ranks, as `set`.

        Example:
            ```python
            ball = sim.ids("ball")
            for step in sim:
                sim.add_force(ball, np.array([0, 0, 2.0]) / len(ball))  # 2 N in all
            ```
        """
        self._changes().add_forces(ids, forces)

    def _changes(self):
        """Return what changes single particles of the run (ParticleChanges)."""
        from vgmpi.solver.run_options import CARD

        from .particle_changes import ParticleChanges

        if self._inner.options.engine == CARD:
            raise ValueError(
                f"engine {CARD} sets no velocities and adds no forces; engine cpu does"
            )
        simulation = self.simulation
        changes: Any = simulation.features.get("particle_changes")
        if changes is None:
            changes = ParticleChanges(simulation)
            features = {"particle_changes": changes, **simulation.features}  # it acts first
            simulation.features.clear()
            simulation.features.update(features)
        return changes

    def stop(self, frame: bool = False) -> None:
        """End the run before its next step, with a checkpoint if it has a folder.

        Call it in a loop over the steps or in `on_frame`. All ranks end together, also if only some
        of them call it. The code of the run is then 75, unless its last step was made.

        Args:
            frame: Whether the present state is written as a frame as well.
        """
        self._inner.ask_to_stop(frame)
