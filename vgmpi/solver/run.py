"""A run from scene to files: prepare, plan, step, write, stop."""

import contextlib
import logging
import platform
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from ..domain.ranks import Alone
from ..output import checkpoint, layout, owner
from ..output.frames import Frames
from ..output.ledger import Ledger, Rows, ledger_columns
from ..output.ledger import check as check_tables
from ..output.read import identity
from ..planning.plan import Plan
from ..planning.price import describe
from ..prepare.motion import gradient
from ..scene.resume import changes, may_change
from ..scene.scene import Scene
from .bounds import check_attrs
from .engines import CARD, ENGINES
from .prepared import Known, keep, on_all, plan_for, prepare, share
from .probes import Probes, files
from .requests import Requests
from .state import frame_rows, restore, save
from .step import BlowUp, Simulation
from .timestep import next_step
from .warm import warm
from .watch import ledger

log = logging.getLogger("vgmpi")

DONE, BLEW_UP, STOPPED = 0, 3, 75


@dataclass
class Options:
    """How to run, beyond what the scene says."""

    folder: Path | None  # None: nothing is written
    threads: int = 1
    engine: str = "cpu"  # see solver.engines
    resume: str | None = None  # a checkpoint's path; "": the newest valid one; None: from the start
    stop_steps: int = 0
    stop_seconds: float = 0.0
    overwrite: bool = False  # replace a run that lies in the folder
    change: bool = False  # resume although the scene has changed
    listeners: list = field(default_factory=list)  # each called with (simulation) after every step
    watchers: list = field(default_factory=list)  # each called with (run) at every frame


class Unfit(ValueError):
    """Options that do not go together, or not with these ranks."""


def check(options: Options, ranks: Alone) -> None:
    """Raises Unfit, before any work is done for a run that cannot be."""
    if options.engine not in (*ENGINES, CARD):
        raise Unfit(f"engine must be one of {', '.join((*ENGINES, CARD))}; got {options.engine!r}")
    if options.threads < 1:
        raise Unfit(f"threads must be at least 1; got {options.threads}")
    if options.engine == "numpy" and (ranks.size > 1 or options.threads > 1):
        raise Unfit(
            "engine numpy computes on one rank and one thread; asked for"
            f" {ranks.size} x {options.threads}"
        )
    if options.engine == CARD:
        _find_card(options, ranks)


def _find_card(options: Options, ranks: Alone) -> None:
    """Choose this rank's card. Raises Unfit, on all ranks, where one of them has none."""
    said = f"engine cuda has no threads; asked for {options.threads}"
    if options.threads == 1:
        try:
            from ..engines.cuda import card

            said = card.choose(ranks.place, ranks.rank)
        except ImportError as error:
            said = f"engine cuda needs `pip install 'vgmpi[cuda]'`: {error}"
    missing = ranks.all_rows(np.array([[ranks.rank]] if said else np.zeros((0, 1)), np.int64))
    if len(missing):
        first = int(missing.min())
        raise Unfit(ranks.bcast(said) or f"engine cuda finds no card on rank {first}")


def begin(
    scene: Scene, plan: Plan, known: Known, ranks: Alone, options: Options, path: Path | None = None
) -> tuple[Simulation, int]:
    """The simulation at its start, or at the checkpoint `path` to resume from; and the next frame's
    number. Collective.
    """
    if options.engine == "cpu":
        warm(plan, ranks)
    simulation = Simulation(
        plan, ranks, known.colliders, options.threads, known.loads, options.engine
    )
    if path is not None:
        with on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
            restore(simulation, saved)
            return simulation, saved.attrs["frame"]
    ids, rows = share(plan, known, ranks, options.folder)
    v = rows.get("v0", np.zeros_like(rows["x0"]))
    C = gradient(scene, rows["x0"], rows["object"])
    simulation.put(
        rows["x0"], v, rows["vol0"], ids, rows["object"], rows.get("theta0"), C, rows.get("sh"),
        rows.get("surface0"),
    )  # fmt: skip
    return simulation, 0


class Runner:
    """One run: its simulation and its files. Collective. Raises BlowUp where not even the step that
    readies the kernels can be made (warm.py).

    probes: rows of the scene's probes; frame: number of the next frame; times: of all frames [s],
    of those that a resumed run has already only their number counts; history: what was changed at
    resumes; path: of the checkpoint to resume from, or None; particles: their identity
    (output.read.identity), None where nothing is written.
    """

    def __init__(
        self, scene: Scene, plan: Plan, known: Known, ranks: Alone, options: Options,
        path: Path | None = None, history: list[dict] | None = None, particles: int | None = None,
    ):  # fmt: skip
        self.particles = particles
        self.scene, self.plan, self.options, self.ranks = scene, plan, options, ranks
        self.names = [thing["name"] for thing in known.objects]
        self.history = history or []
        try:
            self.simulation, self.frame = begin(scene, plan, known, ranks, options, path)
        except BlowUp as error:
            raise BlowUp(str(error).format(*self.names)) from None
        self.times = _times(plan, self.frame, self.simulation.time)
        last_step = None if path is None else self.simulation.step
        self.probes = Probes(scene, self.simulation, options.folder, last_step)
        if options.folder is not None:
            self._open(options.folder, last_step)
        self.first_step = self.simulation.step
        self.requests = Requests(options.stop_steps, options.stop_seconds, scene.output.checkpoint)
        self.warned = False
        self.opening: list[dict] = []
        self.latest: list[dict] = []

    def _open(self, folder: Path, last_step: int | None) -> None:
        self.frames = Frames(folder, self.ranks, self.plan.particles, self.frame, self.particles)
        self.ledger = Ledger(folder, self.ranks, last_step, self.plan.flows)
        self.checkpoints = folder / layout.CHECKPOINTS
        if last_step is None:
            checkpoint.clear(self.checkpoints, self.ranks)

    def go(self) -> int:
        """Run to the end of the scene or until asked to stop; returns the exit code."""
        simulation = self.simulation
        self.opening = self.latest = ledger(simulation)
        if self.frame == 0:
            self._write_frame()
            self.probes.first()
        try:
            while self.frame < len(self.times):
                if self._step():
                    self._checkpoint()
                    return STOPPED
        except BlowUp as error:
            return self._blew_up(str(error).format(*self.names))
        if simulation.step > self.first_step:
            self._checkpoint()  # from which the run can be extended
        else:
            log.info("the run is at %g s: a later time.end extends it", simulation.time)
        return DONE

    def _step(self) -> bool:
        """One step and what follows from it; True when the run shall stop here."""
        simulation = self.simulation
        bound = simulation.bound()
        if self.plan.fixed_dt:
            self._warn_if_too_long(bound)
            bound = self.plan.fixed_dt
        frame = float(self.times[self.frame])
        goal = simulation.ahead(frame)
        dt, lands = next_step(simulation.time, goal, bound)
        done, before = simulation.step + 1 - self.first_step, simulation.time
        stop, due = simulation.advance(dt, self.requests.flags(done), goal if lands else None)
        if lands and goal == frame:
            self._write_frame()
        self.probes.after_step(before)
        for listener in self.options.listeners:
            listener(simulation)
        every = self.scene.output.checkpoint_steps
        if stop and self.frame < len(self.times):
            return True
        if due or (every and simulation.step % every == 0):
            self._checkpoint()
        return False

    def _warn_if_too_long(self, bound: float) -> None:
        """Once: the fixed step was stable at the start, and no longer is."""
        if self.plan.fixed_dt > bound and not self.warned:
            self.warned = True
            log.warning(
                "step %d: time.dt = %.4g s is above the stable step of the present state, %.4g s",
                self.simulation.step, self.plan.fixed_dt, bound,
            )  # fmt: skip

    def _blew_up(self, said: str) -> int:
        """Say what happened, and write the state as it is for a look at it."""
        if self.options.folder is None:
            log.error("blow-up: %s", said)
            return BLEW_UP
        folder = self.options.folder / layout.BLOWUP
        path = self._put_frame(Frames(folder, self.ranks, self.plan.particles), 0)
        log.error("blow-up: %s; frames and checkpoints are whole, this state is in %s", said, path)
        return BLEW_UP

    def _write_frame(self) -> None:
        self.latest = ledger(self.simulation)
        if self.options.folder is not None:
            self._put_frame(self.frames, self.frame)
            self.ledger.append(self.latest)
        for watcher in self.options.watchers:
            watcher(self)
        self.frame += 1
        self._mark("write")

    def _put_frame(self, frames: Frames, number: int) -> Path:
        now = self.simulation
        ids, fields = frame_rows(now, self.scene.output.fields)
        return frames.write(number, now.time, now.step, ids, fields, now.poses())

    def _checkpoint(self) -> None:
        if self.options.folder is None:
            return
        state = save(self.simulation)
        state["attrs"] |= {
            "frame": self.frame,
            "scene_text": self.scene.text,
            "overrides": list(self.scene.overrides),
            "history": self.history,
            "gaussians": self.particles,
            "tables": {table.path.name: table.sum for table in self._tables()},
            "scene": self.scene.resolved(),
            "plan": describe(self.scene, self.plan, ranks=1).splitlines(),
            "versions": versions(),
        }
        path = checkpoint.write(self.checkpoints, self.ranks, state)
        log.info(
            "checkpoint %s at step %d, %.6g s", path, self.simulation.step, self.simulation.time
        )
        self.requests.checkpointed()
        self._mark("write")

    def _tables(self) -> list[Rows]:
        return [self.ledger, *self.probes.files.values()]

    def _mark(self, stage: str) -> None:
        if self.simulation.clock is not None:
            self.simulation.clock(stage)


def _times(plan: Plan, frame: int, now: float) -> np.ndarray:
    """Times of all frames of a run that is at `now` [s] and writes frame number `frame` next."""
    if frame == 0:
        return plan.times
    return np.concatenate([np.full(frame, now), plan.ahead(now)])


@contextlib.contextmanager
def started(
    scene: Scene,
    ranks: Alone,
    options: Options,
    approve: Callable[[Plan, float, Known], None] | None = None,
) -> Iterator[Runner]:
    """Own the folder, check everything, and only then write: a run that is ready to go. Collective.

    approve: called with the plan, the time [s] from which the run goes on, and what is known of its
    particles; may raise. Raises SceneError, StoreError, FolderError, CheckpointError, RunError,
    Unfit, BlowUp.
    """
    check(options, ranks)
    folder, resumed = options.folder, options.resume is not None
    with contextlib.ExitStack() as stack:
        path, history, reached, particles = None, [], 0.0, None
        if folder is not None:
            stack.enter_context(owner.held(folder, ranks, resumed or options.overwrite))
        if folder is not None and options.resume is not None:
            path, attrs = goes_on_from(options.resume, folder, ranks)
            reached = attrs["time"]
            history = _history(scene, attrs, options.change)
            columns = ledger_columns(scene.flows)
            tables = {folder / layout.LEDGER: columns, **files(scene, folder)}
            check_tables(tables, ranks, attrs["step"], attrs.get("tables", {}))
        known = prepare(scene, ranks, folder, resumed)
        plan = plan_for(scene, known)
        if approve is not None:
            approve(plan, reached, known)
        if folder is not None:
            keep(scene, known, ranks, folder)
            made = folder / layout.GAUSSIANS
            particles = on_all(ranks, made, lambda: identity(made))
            if path is not None and attrs.get("gaussians") not in (None, particles):
                raise checkpoint.CheckpointError(f"{path}: is of other particles than {made}")
        yield Runner(scene, plan, known, ranks, options, path, history, particles)


def goes_on_from(given: str, folder: Path, ranks: Alone) -> tuple[Path, dict]:
    """The checkpoint that `--resume` means, and what it says of its run. Raises CheckpointError
    where there is none or it cannot be. Collective."""
    path = checkpoint.chosen(given, folder / layout.CHECKPOINTS, ranks)
    with on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
        check_attrs(path, saved.attrs)
        return path, saved.attrs


def _history(scene: Scene, attrs: dict, change: bool) -> list[dict]:
    """What was changed at resumes, this one's with them. Raises SceneError where something is that
    may not change, unless `change`."""
    history, found = list(attrs.get("history", [])), changes(scene, attrs["scene"])
    if not found:
        return history
    lines = scene.error(found).lines
    if not change:
        free = ", ".join(may_change())
        raise scene.error(found).also(f"--resume may change {free}; with --change all else too")
    for line in lines:
        log.warning("changed from here on: %s", line)
    return [*history, {"step": attrs["step"], "time": attrs["time"], "changes": lines}]


def versions() -> dict[str, str]:
    """What made the file."""
    found = {"python": platform.python_version()}
    for name in ("vgmpi", "numpy", "numba", "h5py", "mpi4py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        found["commit"] = subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        found["commit"] = "unknown"
    return found
