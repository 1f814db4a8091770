"""Driver of a run, from scene to files: prepare, plan, step, write, stop."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vgmpi.io import checkpoint, run_lock
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.initial_conditions import initial_velocity_gradient
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.diagnostics.probe_sampling import Probes
from vgmpi.solver.restart.resume_point import ResumePoint, find_resume_point, identify_particles
from vgmpi.solver.restart.run_files import RunFiles
from vgmpi.solver.restart.state_io import restore

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
from .run_options import Options, check, suit_engine
from .run_outcome import BLEW_UP, DONE, STOPPED, BlowUp
from .simulation import Simulation
from .step_to_target import next_step
from .stop_requests import Requests

log = logging.getLogger("vgmpi")


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

    `names` are those of the objects, `probes` holds the rows of the scene's probes, `files` what
    else the run writes (None without a folder) and `frame` the number of the next frame. `times`
    are the times of all frames [s]; in a resumed run only the number of the past ones counts.
    `is_at_frame` tells whether a frame was written of the present state, and `code` is the exit
    code of a run that has ended.
    """

    def __init__(
        self, scene: Scene, plan: Plan, summary: ParticleSummary, ranks: SerialCommunicator,
        options: Options, resume_point: ResumePoint, particles: int | None = None,
    ):  # fmt: skip
        """Set up the run; raise BlowUp if not even the step of compile_kernels.py can be made.

        Args:
            scene: The scene.
            plan: Its plan.
            summary: Summary of the particles.
            ranks: Communicator.
            options: Options of the run.
            resume_point: Checkpoint from which the run goes on.
            particles: Identity of the particles (particle_set_id), None if nothing is written.
        """
        self.scene, self.plan, self.options, self.ranks = scene, plan, options, ranks
        self.names = [entry["name"] for entry in summary.objects]
        path = resume_point.path
        try:
            self.simulation, self.frame = begin(scene, plan, summary, ranks, options, path)
        except BlowUp as error:
            raise BlowUp(str(error).format(*self.names)) from None
        self.times = _times(plan, self.frame, self.simulation.time)
        last_step = None if path is None else self.simulation.step
        self.probes = Probes(scene, self.simulation, options.folder, last_step)
        self.files: RunFiles | None = None
        if options.folder is not None and particles is not None:
            self.files = RunFiles(
                scene, self.simulation, options.folder, self.frame, last_step, particles,
                resume_point.history,
            )  # fmt: skip
        self.first_step = self.simulation.step
        self.requests = Requests(
            options.stop_steps, options.stop_seconds, scene.output.checkpoint_interval
        )
        self.warned = self.is_at_frame = False
        self.stop_request = False, False  # whether a program asks for a stop, and for a frame at it
        self.code: int | None = None
        self.initial_conservation: list[dict] = []
        self.latest_conservation: list[dict] = []

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
        self._write_start()
        stop = 0.0
        try:
            while self.frame < len(self.times):
                if stop or self._is_asked_to_stop():
                    self._checkpoint()
                    self.code = STOPPED
                    return
                start = simulation.time
                dt, end = self._choose_step()
                flags = self.requests.poll(simulation.step + 1 - self.first_step)
                stop, is_due = simulation.advance(dt, flags, end)
                self.requests.log_stop(stop)
                self._write_step(start, stop, is_due)
                yield
        except BlowUp as error:
            self.code = self._blew_up(str(error).format(*self.names))
            return
        self._write_end()
        self.code = DONE

    def _choose_step(self) -> tuple[float, float | None]:
        """Return the next time step [s], and the time [s] that it must meet exactly or None."""
        simulation = self.simulation
        bound = simulation.bound()
        if self.plan.time_step.fixed:
            self._warn_if_too_long(bound)
            bound = self.plan.time_step.fixed
        target = simulation.next_event_time(float(self.times[self.frame]))
        dt, lands = next_step(simulation.time, target, bound)
        return dt, target if lands else None

    def _warn_if_too_long(self, bound: float) -> None:
        """Warn once if a fixed step that was stable at the start is stable no longer."""
        if self.plan.time_step.fixed > bound and not self.warned:
            self.warned = True
            log.warning(
                "step %d: time.dt = %.4g s is above the stable step of the present state, %.4g s",
                self.simulation.step, self.plan.time_step.fixed, bound,
            )  # fmt: skip

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

    # ---- what is written -------------------------------------------------------------------------

    def _write_start(self) -> None:
        """Take the balance of the present state; write it as frame 0 of a run from its start."""
        self.initial_conservation = self.latest_conservation = conservation_rows(self.simulation)
        if self.frame == 0:
            self._write_frame()
            self.probes.first()
            self.is_at_frame = True

    def _write_step(self, start: float, stop: float, is_due: float) -> None:
        """Write what is due after a step: a frame, rows of probes, a checkpoint.

        Args:
            start: Time before the step [s].
            stop: Whether the run stops here, then with a checkpoint of its own.
            is_due: Whether a checkpoint is due by wall time.
        """
        simulation = self.simulation
        self.is_at_frame = simulation.time == float(self.times[self.frame])
        if self.is_at_frame:
            self._write_frame()
        self.probes.after_step(start)
        for listener in self.options.listeners:
            listener(simulation)
        if stop and self.frame < len(self.times):
            return
        interval = self.scene.output.checkpoint_interval_steps
        if is_due or (interval and simulation.step % interval == 0):
            self._checkpoint()

    def _write_end(self) -> None:
        """Write the checkpoint from which the run can be extended."""
        if self.simulation.step > self.first_step:
            self._checkpoint()
        else:
            log.info("the run is at %g s: a later time.end extends it", self.simulation.time)
        if self.files is not None:
            self.files.frames.check_written()

    def _blew_up(self, message: str) -> int:
        """Log what happened, and write the present state for inspection."""
        kind = "stopped" if is_way_out(message) else "blow-up"
        if self.files is None:
            log.error("%s: %s", kind, message)
            return BLEW_UP
        path = self.files.write_blow_up()
        log.error(
            "%s: %s; frames and checkpoints are whole, this state is in %s", kind, message, path
        )
        return BLEW_UP

    def _write_frame(self) -> None:
        """Write a frame and its conservation entries, and call the watchers."""
        self.latest_conservation = conservation_rows(self.simulation)
        if self.files is not None:
            self.files.write_frame(self.frame, self.latest_conservation)
        for watcher in self.options.watchers:
            watcher(self)
        self.frame += 1
        self._clock_stage("write")

    def _checkpoint(self) -> None:
        """Write a checkpoint."""
        if self.files is None:
            return
        self.files.write_checkpoint(self.frame, list(self.probes.files.values()))
        self.requests.note_checkpoint()
        self._clock_stage("write")

    def _clock_stage(self, stage: str) -> None:
        """Tell the clock that a stage has ended."""
        if self.simulation.clock is not None:
            self.simulation.clock(stage)


def _times(plan: Plan, frame: int, now: float) -> np.ndarray:
    """Return the times of all frames of a run that is at `now` [s] before frame number `frame`."""
    if frame == 0:
        return plan.times
    return np.concatenate([np.full(frame, now), plan.remaining_times(now)])


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
    scene = suit_engine(options.engine, scene, ranks)
    check(options, ranks)
    folder, resumed = options.folder, options.resume is not None
    with contextlib.ExitStack() as stack:
        particles, resume_point = None, ResumePoint()
        if folder is not None:
            stack.enter_context(run_lock.run_lock(folder, ranks, resumed or options.overwrite))
        if folder is not None and options.resume is not None:
            scene, resume_point = find_resume_point(
                scene, options.resume, options.change, folder, ranks
            )
        summary = prepare(scene, ranks, folder, resumed)
        plan = plan_for(scene, summary)
        if approve is not None:
            approve(scene, plan, resume_point.time, summary)
        if folder is not None:
            write_initial_particles(scene, summary, ranks, folder)
            particles = identify_particles(resume_point, folder, ranks)
        yield Runner(scene, plan, summary, ranks, options, resume_point, particles)
