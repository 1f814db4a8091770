"""Plan of a scene without a run, and the speed of this processor on which it is based."""

import argparse
from pathlib import Path

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.launch import launched_by
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.plan import FLOAT_TYPES
from vgmpi.runtime.process_limits import physical_cores
from vgmpi.scene.resume_rules import with_accuracy_of_run
from vgmpi.scene.scene import Scene
from vgmpi.solver import initial_particles
from vgmpi.solver.estimates import calibration
from vgmpi.solver.estimates.pilot_run import default_pilot_run, pilot_run
from vgmpi.solver.restart.resume_point import resolve_checkpoint
from vgmpi.solver.run_options import suit_engine

from .messages import card_module
from .rank_supervisor import find_mpirun
from .start import choose_ranks


def describe_plan(
    scene: Scene, folder: Path, args: argparse.Namespace, ranks: SerialCommunicator
) -> tuple[str, int]:
    """Return the text of a plan on rank 0, else "", and the memory of the run [bytes]. Collective.

    Args:
        scene: The scene.
        folder: Output folder, whose checkpoints `--resume` means.
        args: Flags of the command line.
        ranks: Communicator.

    Raises:
        SceneError, CheckpointError, InvalidRunOptions.
    """
    scene = suit_engine(args.engine, scene, ranks)
    start_time = 0.0
    if args.resume is not None:
        attrs = resolve_checkpoint(args.resume, folder, ranks)[1]
        start_time, scene = attrs["time"], with_accuracy_of_run(scene, attrs["scene"])
    summary = initial_particles.prepare(scene, ranks, None)
    plan = initial_particles.plan_for(scene, summary)
    if ranks.rank != 0:
        return "", plan.bytes()
    pace = calibration.host_throughput(scene.accuracy.precision, remeasure=args.calibrate)
    pilot = None
    if args.pilot:
        pilot = pilot_run(scene, plan, summary)
    elif start_time == 0:
        pilot = default_pilot_run(scene, plan, summary, pace)
    count, reason = planned_ranks(scene, args, ranks)
    lines = [format_plan(scene, plan, count, start_time, pace, pilot, args.verbose, reason)]
    if args.engine == "cuda":
        lines.append(card_module(ranks).memory_report(plan, count))
    return "\n".join(lines), plan.bytes()


def planned_ranks(
    scene: Scene, args: argparse.Namespace, ranks: SerialCommunicator
) -> tuple[int, str]:
    """Return the number of ranks that a run with these flags takes, and why if it chooses them.

    Cores count as free: those that other programs use now may be free when the run begins.

    Args:
        scene: The scene.
        args: Flags of the command line.
        ranks: Communicator.
    """
    if ranks.size > 1 or launched_by():
        return ranks.size, ""
    if args.ranks is not None:
        return args.ranks, ""
    cores = physical_cores()
    if args.threads > 1 or args.engine != "cpu" or cores == 1:
        return 1, ""
    choice = choose_ranks(scene, cores, args.stop_steps, args.stop_seconds)
    used = f"{choice.ranks} of {cores} cores"
    if choice.reason:
        return choice.ranks, f"{used}: {choice.reason.removesuffix(' (plan)')}"
    if find_mpirun() is None:
        return 1, f"there is no mpirun here: a run takes {choice.ranks} threads"
    return choice.ranks, f"{used}, which a run takes by itself if they are free"


def calibrate(ranks: SerialCommunicator) -> int:
    """Measure this processor in every precision; return the exit code."""
    for precision in FLOAT_TYPES if ranks.rank == 0 else ():
        pace = calibration.host_throughput(precision, remeasure=True)
        print(
            f"{precision:6s}  {pace.fluid:.1f} ns per particle and step of a fluid,"
            f" {pace.elastic:.1f} elastic: {pace.origin}"
        )
    return 0
