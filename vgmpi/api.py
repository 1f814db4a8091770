"""Public Python API: load a scene, plan it, run it, and read the files of a run.

Example:
    ```python
    import vgmpi

    scene = vgmpi.load("scene.toml", {"domain.cell": "1 cm"})
    print(f"{vgmpi.plan(scene).particles} particles")
    run = vgmpi.run(scene, "out", on_frame=lambda run: print(run.time))
    files = vgmpi.read("out")
    print(files.times, files.frame(-1)["positions"].mean(axis=0))
    ```
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.io.run_reader import RunReader as read
from vgmpi.parallel.communicator import SerialCommunicator, init_communicator
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.scene import Scene

from .scene import loader
from .solver.steering.steered_run import Run

__all__ = ["Run", "SceneError", "load", "plan", "read", "run", "simulate"]


def load(
    scene: str | Path | Mapping[str, Any],
    overrides: Mapping[str, Any] | Sequence[str] = (),
    text: str | None = None,
) -> Scene:
    """Read and check a scene.

    Args:
        scene: Scene file (TOML), or its content as a nested dict: tables are dicts, lists of tables
            are lists of dicts. Numbers may be NumPy's, vectors arrays. Files that a dict names are
            looked for in the current folder; messages name the path of a key.
        overrides: Values that replace keys of the scene: a mapping such as
            `{"domain.cell": "1 cm"}`, or texts such as `["domain.cell=1 cm"]`, as for `--set`.
        text: The scene itself. Nothing is then read from the file, which names the scene in
            messages; other files are looked for in its folder.

    Returns:
        The checked scene.

    Raises:
        SceneError: If anything is wrong with the scene; it has one line per error.
        ValueError: If a dict and a text are given.

    Example:
        ```python
        scene = vgmpi.load("ball.toml", {"time.end": "20 ms", "domain.gravity": [0, 0, 0]})
        drop = vgmpi.load({
            "domain": {"size": [0.24, 0.24, 0.24], "cell": "2 cm"},
            "time": {"end": "10 ms", "frames": 3},
            "material": {"water": {"kind": "fluid"}},
            "object": [{"name": "drop", "material": "water",
                        "shape": {"sphere": {"center": [0.12, 0.12, 0.12], "radius": 0.05}}}],
        })
        ```
    """
    if isinstance(scene, Mapping) and text is not None:
        raise ValueError("a scene is either a dict or a text; both are given")
    if isinstance(overrides, Mapping):
        overrides = [f"{key}={_toml(value)}" for key, value in overrides.items()]
    return loader.load(scene, tuple(overrides), text)


def _toml(value: Any) -> str:
    """Return a value as the text that --set takes."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(map(_quoted, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_quoted(item)}' for key, item in value.items())}}}"
    return str(value)


def _quoted(value: Any) -> str:
    """Return an item of a list or a table as TOML; texts in quotes."""
    return f'"{value}"' if isinstance(value, str) else _toml(value)


def plan(scene: Scene, ranks: SerialCommunicator | None = None) -> Plan:
    """Work out what a scene needs: particles, phases, memory and time step. Collective.

    The particles are made for this and then dropped.

    Args:
        scene: A scene from `load`.
        ranks: Communicator, by default this process alone.

    Returns:
        The plan, with `particles`, `phases`, `groups`, `times` [s] and `bytes()`.

    Raises:
        SceneError: If the particles cannot be made, or the plan is not possible.

    Example:
        ```python
        plan = vgmpi.plan(scene)
        print(f"{plan.particles} particles, {plan.bytes() / 2**30:.1f} GiB")
        ```
    """
    from vgmpi.solver.initial_particles import plan_for, prepare

    return plan_for(scene, prepare(scene, ranks or SerialCommunicator(), None))


def run(
    scene: Scene,
    folder: str | Path | None = None,
    on_frame: Callable[[Run], None] | None = None,
    ranks: SerialCommunicator | None = None,
    threads: int = 1,
    engine: str = "cpu",
    overwrite: bool = False,
    progress: bool | None = None,
) -> Run:
    """Run a scene from its start to its end.

    Args:
        scene: A scene from `load`.
        folder: Output folder, or None to write no files.
        on_frame: Function that is called with the `Run` at every frame, first at time 0.
        ranks: Communicator, by default that of all ranks that mpirun started; every rank must call
            every function.
        threads: Threads per rank.
        engine: `"cpu"`, `"cuda"` (one GPU for each rank), or `"numpy"` (slow, for comparison, on
            one rank and one thread).
        overwrite: Replace an existing run in the folder.
        progress: Whether a bar shows the progress; by default on a terminal and in a notebook.

    Returns:
        The run at its end; a blow-up is code 3.

    Raises:
        SceneError: If the particles cannot be made, or the plan is not possible.
        StoreError: If a file cannot be written.
        RunFolderInUseError: If the folder belongs to another run (vgmpi.io.run_lock).
        ValueError: If engine, ranks and threads exclude each other.
        BlowUp: If the run blows up before its first frame.

    Example:
        ```python
        def report(run):
            print(f"{run.time:.3f} s: {run.array('x').mean(axis=0)}")

        run = vgmpi.run(scene, "out", on_frame=report)
        assert run.code == 0
        ```
    """
    with simulate(scene, folder, ranks, threads, engine, overwrite, progress) as state:
        if on_frame is not None:
            state._inner.options.watchers.append(lambda run: on_frame(state))
        for _ in state:
            pass
    return state


@contextlib.contextmanager
def simulate(
    scene: Scene,
    folder: str | Path | None = None,
    ranks: SerialCommunicator | None = None,
    threads: int = 1,
    engine: str = "cpu",
    overwrite: bool = False,
    progress: bool | None = None,
) -> Iterator[Run]:
    """Prepare a run whose steps a loop makes, one after the other. Collective.

    The state at time 0 is there before the loop; the loop makes a step, then runs its body. Frames,
    probes and checkpoints are written as in `run`. On several ranks every rank runs the loop. After
    `break` the run can go on with another loop; leaving the block closes the files of the run, but
    only `stop` and the end of the scene write a checkpoint.

    Args:
        scene: A scene from `load`.
        folder: Output folder, or None to write no files.
        ranks: As for `run`, and so are the others.
        threads: Threads per rank.
        engine: Engine.
        overwrite: Replace an existing run in the folder.
        progress: Whether a bar shows the progress.

    Yields:
        The run, which a loop steps.

    Raises:
        SceneError, StoreError, RunFolderInUseError, ValueError, BlowUp: As `run`.

    Example:
        ```python
        with vgmpi.simulate(scene, "out") as sim:
            for step in sim:
                if sim.array("positions")[:, 2].min() < 0.02:
                    sim.stop(frame=True)
        print(sim.code, sim.time)
        ```
    """
    from .solver.diagnostics.progress import is_interactive, shown_progress
    from .solver.run import Options, prepared_run

    options = Options(
        None if folder is None else Path(folder), threads, engine, overwrite=overwrite, steered=True
    )
    with prepared_run(scene, ranks or init_communicator(), options) as inner:
        with shown_progress(inner, is_interactive() if progress is None else progress):
            yield Run(inner)
