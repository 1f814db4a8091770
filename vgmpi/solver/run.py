"""Driver of a run, from scene to files: prepare, plan, step, write, stop."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vgmpi.io import checkpoint, file_layout, run_lock
from vgmpi.io.csv_log import ConservationLog, CsvLog, ledger_columns, optional_ledger_columns
from vgmpi.io.csv_log import verify_logs as check_tables
from vgmpi.io.frames import Frames
from vgmpi.io.run_reader import particle_set_id
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.initial_conditions import initial_velocity_gradient
from vgmpi.runtime.versions import versions
from vgmpi.scene.resume_rules import (
    changes_without_effect,
    forbidden_changes,
    may_change,
    with_accuracy_of_run,
)
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.diagnostics.liquid_fill import liquid_phases
from vgmpi.solver.diagnostics.probe_sampling import Probes, files
from vgmpi.solver.restart.checkpoint_validation import check_attrs
from vgmpi.solver.restart.state_io import frame_rows, restore, save

from .compile_kernels import compile_kernels
from .failure_message import is_way_out
from .initial_particles import (
    ParticleSummary,
    on_all,
    plan_for,
    prepare,
    rows_of_this_rank,
    write_initial_particles,
)
from .run_options import Options, check, check_engine
from .simulation import BlowUp, Simulation
from .step_to_target import next_step
from .stop_requests import Requests

log = logging.getLogger("vgmpi")

DONE, BLEW_UP, STOPPED = 0, 3, 75


def begin(
    scene: Scene, plan: Plan, summary: ParticleSummary, ranks: SerialCommunicator,
    options: Options, path: Path | None = None,
) -> tuple[Simulation, int]:  # fmt: skip
    """Return the simulation at its start or a checkpoint, and the next frame. Collective.

    Args:
        scene: The scene.
        plan: Its plan.
        summary: Summary of the particles.
        ranks: Communicator.
        options: Options of the run.
        path: Checkpoint from which the run goes on, or None.
    """
    if options.engine == "cpu":
        compile_kernels(plan, ranks)
    simulation = Simulation(plan, ranks, summary.colliders, options.threads, options.engine)
    if path is not None:
        with on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
            restore(simulation, saved)
            return simulation, saved.attrs["frame"]
    ids, rows = rows_of_this_rank(plan, summary, ranks, options.folder)
    v = rows.get("v0", np.zeros_like(rows["x0"]))
    C = initial_velocity_gradient(scene, rows["x0"], rows["object"])
    simulation.put(
        rows["x0"], v, rows["vol0"], ids, rows["object"], rows.get("theta0"), C, rows.get("sh"),
        rows.get("surface0"),
    )  # fmt: skip
    return simulation, 0


class Runner:
    """One run with its simulation and its files. All methods are collective.

    `probes` holds the rows of the scene's probes and `frame` the number of the next frame. `times`
    are the times of all frames [s]; in a resumed run only the number of the past ones counts.
    `is_at_frame` tells whether a frame was written of the present state, and `code` is the exit
    code of a run that has ended.
    `history` lists what was changed at resumes. `path` is the checkpoint to resume from, or None;
    `particles` the identity of the particles (particle_set_id), None if nothing is written.
    """

    def __init__(
        self, scene: Scene, plan: Plan, summary: ParticleSummary, ranks: SerialCommunicator,
        options: Options,
        path: Path | None = None, history: list[dict] | None = None, particles: int | None = None,
    ):  # fmt: skip
        """Set up the run; raise BlowUp if not even the step of compile_kernels.py can be made."""
        self.particles = particles
        self.scene, self.plan, self.options, self.ranks = scene, plan, options, ranks
        self.names = [entry["name"] for entry in summary.objects]
        self.history = history or []
        try:
            self.simulation, self.frame = begin(scene, plan, summary, ranks, options, path)
        except BlowUp as error:
            raise BlowUp(str(error).format(*self.names)) from None
        self.times = _times(plan, self.frame, self.simulation.time)
        last_step = None if path is None else self.simulation.step
        self.probes = Probes(scene, self.simulation, options.folder, last_step)
        if options.folder is not None:
            self._open(options.folder, last_step)
        self.first_step = self.simulation.step
        self.requests = Requests(
            options.stop_steps, options.stop_seconds, scene.output.checkpoint_interval
        )
        self.warned = self.is_at_frame = False
        self.stop_request = False, False  # whether a program asks for a stop, and for a frame at it
        self.code: int | None = None
        self.initial_conservation: list[dict] = []
        self.latest_conservation: list[dict] = []

    def _open(self, folder: Path, last_step: int | None) -> None:
        """Open frames, conservation log and checkpoints."""
        self.versions = versions()  # asked here, since a stop may leave little time to a checkpoint
        compresses = self.scene.output.compression == "gzip"
        self.frames = Frames(
            folder, self.ranks, self.plan.particles, self.frame, self.particles, compresses
        )
        liquids = bool(liquid_phases(self.plan))
        self.ledger = ConservationLog(
            folder,
            self.ranks,
            last_step,
            self.plan.is_open_system,
            liquids,
            any(feature.has_momentum for feature in self.plan.features),
        )
        self.checkpoints = folder / file_layout.CHECKPOINTS
        if last_step is None:
            checkpoint.clear(self.checkpoints, self.ranks)

    def run(self) -> int:
        """Run to the end of the scene or to a stop request; return the exit code."""
        for _ in self.steps():
            pass
        assert self.code is not None
        return self.code

    def steps(self) -> Iterator[None]:
        """Run to the end of the scene or to a stop request, and yield after every step.

        `code` is the exit code once there are no more steps.
        """
        simulation = self.simulation
        self.initial_conservation = self.latest_conservation = conservation_rows(simulation)
        if self.frame == 0:
            self._write_frame()
            self.probes.first()
            self.is_at_frame = True
        stop = False
        try:
            while self.frame < len(self.times):
                if stop or self._is_asked_to_stop():
                    self._checkpoint()
                    self.code = STOPPED
                    return
                stop = self._step()
                yield
        except BlowUp as error:
            self.code = self._blew_up(str(error).format(*self.names))
            return
        if simulation.step > self.first_step:
            self._checkpoint()  # the run can be extended from it
        else:
            log.info("the run is at %g s: a later time.end extends it", simulation.time)
        if self.options.folder is not None:
            self.frames.check_written()
        self.code = DONE

    def ask_to_stop(self, frame: bool = False) -> None:
        """Ask for a stop before the next step; `frame`: with a frame of the present state.

        It counts on any rank, in runs whose options allow it (Options.steered).
        """
        self.stop_request = True, frame

    def _is_asked_to_stop(self) -> bool:
        """Return whether a rank asks for a stop, after writing the frame that it asks for."""
        if not self.options.steered:
            return False
        stop, frame = self.ranks.max(np.array(self.stop_request, float))
        if frame and not self.is_at_frame:
            self._write_frame()
        return bool(stop)

    def _step(self) -> bool:
        """Make one step and write what is due after it; return whether the run must stop here."""
        simulation = self.simulation
        bound = simulation.bound()
        if self.plan.fixed_dt:
            self._warn_if_too_long(bound)
            bound = self.plan.fixed_dt
        frame = float(self.times[self.frame])
        target = simulation.next_event_time(frame)
        dt, lands = next_step(simulation.time, target, bound)
        steps_done, before = simulation.step + 1 - self.first_step, simulation.time
        stop, due = simulation.advance(
            dt, self.requests.poll(steps_done), target if lands else None
        )
        self.requests.log_stop(stop)
        self.is_at_frame = lands and target == frame
        if self.is_at_frame:
            self._write_frame()
        self.probes.after_step(before)
        for listener in self.options.listeners:
            listener(simulation)
        interval = self.scene.output.checkpoint_interval_steps
        if stop and self.frame < len(self.times):
            return True
        if due or (interval and simulation.step % interval == 0):
            self._checkpoint()
        return False

    def _warn_if_too_long(self, bound: float) -> None:
        """Warn once if a fixed step that was stable at the start is stable no longer."""
        if self.plan.fixed_dt > bound and not self.warned:
            self.warned = True
            log.warning(
                "step %d: time.dt = %.4g s is above the stable step of the present state, %.4g s",
                self.simulation.step, self.plan.fixed_dt, bound,
            )  # fmt: skip

    def _blew_up(self, message: str) -> int:
        """Log what happened, and write the present state for inspection."""
        kind = "stopped" if is_way_out(message) else "blow-up"
        if self.options.folder is None:
            log.error("%s: %s", kind, message)
            return BLEW_UP
        folder = self.options.folder / file_layout.BLOWUP
        path = self._write_frame_file(Frames(folder, self.ranks, self.plan.particles), 0)
        log.error(
            "%s: %s; frames and checkpoints are whole, this state is in %s", kind, message, path
        )
        return BLEW_UP

    def _write_frame(self) -> None:
        """Write a frame and its conservation entries, and call the watchers."""
        self.latest_conservation = conservation_rows(self.simulation)
        if self.options.folder is not None:
            self._write_frame_file(self.frames, self.frame)
            self.ledger.append(self.latest_conservation)
        for watcher in self.options.watchers:
            watcher(self)
        self.frame += 1
        self._clock_stage("write")

    def _write_frame_file(self, frames: Frames, number: int) -> Path:
        """Write the present state as frame number `number`; return its path."""
        simulation = self.simulation
        ids, fields = frame_rows(simulation, self.scene.output.fields)
        return frames.write(
            number, simulation.time, simulation.step, ids, fields, simulation.poses()
        )

    def _checkpoint(self) -> None:
        """Write a checkpoint."""
        if self.options.folder is None:
            return
        state = save(self.simulation)
        state["attrs"] |= {
            "frame": self.frame,
            "scene_text": self.scene.text,
            "overrides": list(self.scene.overrides),
            "resume_history": self.history,
            "gaussians_crc": self.particles,
            "log_checksums": {table.path.name: table.sum for table in self._tables()},
            "scene": self.scene.to_json(),
            "plan_report": format_plan(self.scene, self.plan, ranks=1).splitlines(),
            "versions": self.versions,
        }
        path = checkpoint.write(self.checkpoints, self.ranks, state)
        log.info(
            "checkpoint %s at step %d, %.6g s", path, self.simulation.step, self.simulation.time
        )
        self.requests.note_checkpoint()
        self._clock_stage("write")

    def _tables(self) -> list[CsvLog]:
        """Return all CSV tables of the run."""
        return [self.ledger, *self.probes.files.values()]

    def _clock_stage(self, stage: str) -> None:
        """Tell the clock that a stage has ended."""
        if self.simulation.clock is not None:
            self.simulation.clock(stage)


def _times(plan: Plan, frame: int, now: float) -> np.ndarray:
    """Return the times of all frames of a run that is at `now` [s] before frame number `frame`."""
    if frame == 0:
        return plan.times
    return np.concatenate([np.full(frame, now), plan.ahead(now)])


@contextlib.contextmanager
def prepared_run(
    scene: Scene,
    ranks: SerialCommunicator,
    options: Options,
    approve: Callable[[Scene, Plan, float, ParticleSummary], None] | None = None,
) -> Iterator[Runner]:
    """Lock the folder, check everything, then write: yield a run that is ready. Collective.

    Args:
        scene: The scene.
        ranks: Communicator.
        options: Options of the run.
        approve: Function of the scene, its plan, the time [s] from which the run goes on, and the
            summary of its particles; it may raise.

    Raises:
        SceneError, StoreError, RunFolderInUseError, CheckpointError, RunError, InvalidRunOptions,
        BlowUp.
    """
    check_engine(options.engine, scene)
    check(options, ranks)
    folder, resumed = options.folder, options.resume is not None
    with contextlib.ExitStack() as stack:
        path, history, start_time, particles = None, [], 0.0, None
        if folder is not None:
            stack.enter_context(run_lock.run_lock(folder, ranks, resumed or options.overwrite))
        if folder is not None and options.resume is not None:
            path, attrs = resolve_checkpoint(options.resume, folder, ranks)
            start_time = attrs["time"]
            scene = with_accuracy_of_run(scene, attrs["scene"])
            history = _history(scene, attrs, options.change)
            ledger = folder / file_layout.LEDGER
            present = False, False
            if ranks.rank == 0:  # it reads the tables
                present = optional_ledger_columns(ledger, *present)
            columns = ledger_columns(scene.is_open_system, *present)
            tables = {ledger: columns, **files(scene, folder)}
            check_tables(tables, ranks, attrs["step"], attrs.get("log_checksums", {}))
        summary = prepare(scene, ranks, folder, resumed)
        plan = plan_for(scene, summary)
        if approve is not None:
            approve(scene, plan, start_time, summary)
        if folder is not None:
            write_initial_particles(scene, summary, ranks, folder)
            gaussians = folder / file_layout.GAUSSIANS
            particles = on_all(ranks, gaussians, lambda: particle_set_id(gaussians))
            if path is not None and attrs.get("gaussians_crc") not in (None, particles):
                raise checkpoint.CheckpointError(f"{path}: is of other particles than {gaussians}")
        yield Runner(scene, plan, summary, ranks, options, path, history, particles)


def resolve_checkpoint(
    requested: str, folder: Path, ranks: SerialCommunicator
) -> tuple[Path, dict]:
    """Return the checkpoint that `--resume` means, and its attributes. Collective.

    `requested` is its path, or "" for the newest valid one. Raises CheckpointError if there is
    none or it is not valid.
    """
    path = checkpoint.select(requested, folder / file_layout.CHECKPOINTS, ranks)
    with on_all(ranks, path, lambda: checkpoint.open(path)) as saved:
        check_attrs(path, saved.attrs)
        return path, saved.attrs


def _history(scene: Scene, attrs: dict, change: bool) -> list[dict]:
    """Return the changes of the scene at all resumes, including this one.

    Raises:
        SceneError: If a key has changed that may not, unless `change` is set, or one that cannot.
    """
    history = list(attrs.get("resume_history", []))
    differences = forbidden_changes(scene, attrs["scene"])
    if not differences:
        return history
    lines = scene.error(differences).lines
    if not change:
        free = ", ".join(may_change())
        raise scene.error(differences).with_line(
            f"--resume may change {free}; with --change all else too"
        )
    if without_effect := changes_without_effect(scene, differences):
        raise scene.error(without_effect)
    for line in lines:
        log.warning("changed from here on: %s", line)
    return [*history, {"step": attrs["step"], "time": attrs["time"], "changes": lines}]
