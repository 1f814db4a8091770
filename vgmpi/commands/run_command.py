"""Run of a scene by the command line: the plan before it, the progress, and the report after it."""

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
from vgmpi.solver.run import BLEW_UP, DONE, Options, prepared_run
from vgmpi.solver.run_options import InvalidRunOptions
from vgmpi.solver.simulation import BlowUp
from vgmpi.solver.stop_requests import begin_steps

from .cli import card_module, memory_refusal, refuse

log = logging.getLogger("vgmpi")


class PlanApproval:
    """Printer of a run's plan, which refuses a run that exceeds the memory.

    Attributes:
        estimator: Estimator of the remaining time by a pilot run, or None.
        prediction: Predicted time [s] of a run from its start; 0 if it is unknown.
    """

    def __init__(self, args: argparse.Namespace, ranks: SerialCommunicator):
        self.args, self.ranks = args, ranks
        self.estimator: RemainingTimeEstimator | None = None
        self.prediction = 0.0

    def __call__(
        self, scene: Scene, plan: Plan, start_time: float, summary: ParticleSummary
    ) -> None:
        """Print the plan on rank 0. Raises SceneError if the memory is too small."""
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


def run_scene(
    scene: Scene, folder: Path, args: argparse.Namespace, ranks: SerialCommunicator
) -> int:
    """Run a scene and report; return the exit code. Collective.

    Args:
        scene: The scene.
        folder: Output folder.
        args: Flags of the command line.
        ranks: Communicator.
    """
    approval = PlanApproval(args, ranks)
    options = Options(
        folder, args.threads, args.engine, args.resume, args.stop_steps, args.stop_seconds,
        args.overwrite, args.change,
    )  # fmt: skip
    try:
        with prepared_run(scene, ranks, options, approval) as run:
            clock = run.simulation.clock = Clock()
            if args.engine == "cpu":  # the work of a card takes no time of the processor
                run.simulation.pace.busy = lambda: clock.work
            progress = Progress(run, args.quiet, approval.estimator)
            observer = RunObserver()
            options.listeners += [progress, observer.step]
            options.watchers.append(lambda run: observer.frame(run.latest_conservation))
            begin_steps()
            if args.live is not None and ranks.rank == 0:
                start_live_page(folder, args.live)
            if isinstance(ranks, MpiCommunicator) and ranks.size > 1 and ranks.rank == 0:
                job = os.environ.get("SLURM_JOB_ID")
                supervisor = os.environ.get(SUPERVISOR_VARIABLE)
                log.info(describe_stop(ranks.library, find_launcher(), job, supervisor))
            code = run.run()
            progress.close()
            lines = [timing_table(run, clock)]
            if code == DONE and approval.prediction:
                duration = format_duration(clock.last - clock.began)
                prediction = format_duration(approval.prediction)
                lines.append(f"  predicted  about {prediction}; the run took {duration}")
            if code == DONE and run.first_step == 0:  # the whole run was observed
                lines += advice(run.scene, run.plan, observer)
            if args.profile:
                lines.append(rank_profile(run, clock))
    except InvalidRunOptions as error:
        return refuse([f"--{error}"], ranks)
    except BlowUp as error:  # before the first frame
        log.error("blow-up: %s", error)
        return BLEW_UP
    if ranks.rank == 0 and not args.quiet:
        outcome = {0: "done", 3: "blew up", 75: "stopped; go on with --resume"}[code]
        print(*lines, f"{outcome}: {folder}", sep="\n", flush=True)
    return code


def _throughput(precision: str, remeasure: bool) -> Throughput | None:
    """Return the throughput of this processor, measured or cached."""
    if remeasure:
        return calibration.host_throughput(precision, remeasure=True)
    return calibration.cached_throughput(precision)
