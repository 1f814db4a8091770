"""What the command line prints of a run: the plan before it, its progress, and the report after."""

import argparse
import logging
import os
from pathlib import Path

from vgmpi.parallel.communicator import MpiCommunicator, SerialCommunicator
from vgmpi.parallel.launch import SUPERVISOR_VARIABLE, describe_stop, find_launcher
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.run_estimate import predicted_seconds
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT, Throughput
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.schema import SceneError
from vgmpi.runtime.live_process import start_live_page
from vgmpi.runtime.message_text import format_duration
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.eta import RemainingTimeEstimator
from vgmpi.solver.diagnostics.post_run_advice import RunObserver, advice
from vgmpi.solver.diagnostics.progress import Clock, Progress, rank_profile, timing_table
from vgmpi.solver.estimates import calibration
from vgmpi.solver.estimates.pilot_run import pilot_run
from vgmpi.solver.initial_particles import ParticleSummary
from vgmpi.solver.run import Runner
from vgmpi.solver.run_outcome import BLEW_UP, DONE, STOPPED

from .messages import card_module, memory_refusal

log = logging.getLogger("vgmpi")

OUTCOMES = {DONE: "done", BLEW_UP: "blew up", STOPPED: "stopped; go on with --resume"}


class RunReport:
    """Printer of a run's plan, progress and end. All methods are collective.

    Attributes:
        estimator: Estimator of the remaining time by a pilot run, or None.
        prediction: Predicted time [s] of a run from its start; 0 if it is unknown.
        lines: Lines of the end: times by stage, prediction and advice.
    """

    def __init__(self, args: argparse.Namespace, ranks: SerialCommunicator):
        self.args, self.ranks = args, ranks
        self.estimator: RemainingTimeEstimator | None = None
        self.prediction = 0.0
        self.clock: Clock
        self.progress: Progress
        self.observer = RunObserver()
        self.lines: list[str] = []

    def print_plan(
        self, scene: Scene, plan: Plan, start_time: float, summary: ParticleSummary
    ) -> None:
        """Print the plan on rank 0. Raises SceneError if the memory is too small.

        Args:
            scene: The scene.
            plan: Its plan.
            start_time: Time from which the run goes on [s].
            summary: Summary of the particles.
        """
        args, ranks = self.args, self.ranks
        refusal = memory_refusal(plan.bytes(), ranks)
        if args.engine == "cuda":
            refusal = refusal or card_module(ranks).memory_error(plan, ranks)
        if refusal and not args.force:
            raise SceneError([refusal + "; --force runs it anyway"])
        if ranks.rank != 0 or args.quiet:
            return
        real = scene.accuracy.precision
        pace = _throughput(real, args.calibrate)
        pilot = pilot_run(scene, plan, summary) if args.pilot else None
        if pilot is not None:
            self.estimator = RemainingTimeEstimator(
                *pilot.remaining_cost(scene, plan, pace or ASSUMED_THROUGHPUT[real])
            )
        text = format_plan(scene, plan, ranks.size, start_time, pace, pilot, args.verbose)
        print(text, flush=True)
        if pace is not None and start_time == 0:
            self.prediction = predicted_seconds(scene, plan, ranks.size, pace, pilot)

    def follow(self, run: Runner) -> None:
        """Measure the times of the steps, show the progress, and observe what advice needs."""
        clock = self.clock = run.simulation.clock = Clock()
        if self.args.engine == "cpu":  # the work of a card takes no time of the processor
            run.simulation.pace.busy = lambda: clock.work
        self.progress = Progress(run, self.args.quiet, self.estimator)
        run.options.listeners += [self.progress, self.observer.step]
        run.options.watchers.append(lambda run: self.observer.frame(run.latest_conservation))

    def announce(self, folder: Path) -> None:
        """Start the live page, and log how to stop a run of several ranks."""
        if self.args.live is not None and self.ranks.rank == 0:
            start_live_page(folder, self.args.live)
        if isinstance(self.ranks, MpiCommunicator) and self.ranks.size > 1 and self.ranks.rank == 0:
            job = os.environ.get("SLURM_JOB_ID")
            supervisor = os.environ.get(SUPERVISOR_VARIABLE)
            log.info(describe_stop(self.ranks.library, find_launcher(), job, supervisor))

    def end(self, run: Runner) -> None:
        """Close the progress and collect the lines of the end."""
        self.progress.close()
        clock, prediction = self.clock, self.prediction
        self.lines = [timing_table(run, clock)]
        if run.code == DONE and prediction:
            duration = format_duration(clock.last - clock.began)
            self.lines.append(
                f"  predicted  about {format_duration(prediction)}; the run took {duration}"
            )
        if run.code == DONE and run.first_step == 0:  # the whole run was observed
            self.lines += advice(run.scene, run.plan, self.observer)
        if self.args.profile:
            self.lines.append(rank_profile(run, clock))

    def print_end(self, folder: Path, code: int) -> None:
        """Print the lines of the end and the outcome on rank 0."""
        if self.ranks.rank == 0 and not self.args.quiet:
            print(*self.lines, f"{OUTCOMES[code]}: {folder}", sep="\n", flush=True)


def _throughput(precision: str, remeasure: bool) -> Throughput | None:
    """Return the throughput of this processor, measured or cached."""
    if remeasure:
        return calibration.host_throughput(precision, remeasure=True)
    return calibration.cached_throughput(precision)
