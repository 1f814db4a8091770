"""Commands on a scene: what is asked for, the ranks and the signals of it, and the run itself.

`run` -> `main` -> `run_scene` -> `Runner.steps` -> `Simulation.advance` is the path from the
command to the step (docs/developer/developing.md). What needs numba is imported where it is used.
"""

import argparse
import contextlib
import logging
import os
import sys
from pathlib import Path

from vgmpi.io import file_layout, run_lock, run_reader
from vgmpi.parallel.communicator import SerialCommunicator, init_communicator
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.stop_requests import (
    EndedBySignalError,
    begin_steps,
    signals_heard,
    take_ending_signals,
)

from . import rank_supervisor, start
from .flags import is_run, parse_arguments
from .messages import (
    ONE_LINE_ERRORS,
    folder_refusal,
    log_to_stderr,
    memory_refusal,
    print_error,
    rank_refusal,
    refuse,
)

log = logging.getLogger("vgmpi")


def run(words: list[str]) -> int:
    """Run a scene on the cores that it pays for; return the exit code.

    Only a command line comes here. `main` and the Python interface start no processes.

    Args:
        words: Words of the command line.
    """
    name = os.environ.pop(rank_supervisor.SOCKET_VARIABLE, None)
    if name is not None:
        return rank_supervisor.run_as_rank(name, main, words)
    code, words = start.run_on_ranks(words)
    return main(words) if code is None else code


def main(words: list[str] | None = None) -> int:
    """Run a command on a scene in this process; return the exit code."""
    args = parse_arguments(words)
    if args.inspect is not None:
        return _inspect(args.inspect)
    log_to_stderr(args, first=True)
    ranks = SerialCommunicator()
    with signals_heard() if is_run(args) else contextlib.nullcontext():
        try:
            ranks = ranks if args.check else init_communicator()
            log_to_stderr(args, first=ranks.rank == 0)
            take_ending_signals()
            return run_scene(args, ranks) if is_run(args) else _preview(args, ranks)
        except EndedBySignalError as end:
            log.error("%s", end.line)
            if ranks.size > 1:
                ranks.abort(end.exit_code)  # the others may wait for this one
            return end.exit_code


def run_scene(args: argparse.Namespace, ranks: SerialCommunicator) -> int:
    """Run a scene and report; return the exit code. Collective.

    Args:
        args: Flags of the command line.
        ranks: Communicator.
    """
    try:
        scene, folder = _load(args, ranks)
        from vgmpi.solver.run import prepared_run
        from vgmpi.solver.run_options import Options

        from .run_report import RunReport

        report = RunReport(args, ranks)
        options = Options(
            folder, args.threads, args.engine, args.resume, args.stop_steps, args.stop_seconds,
            args.overwrite, args.change,
        )  # fmt: skip
        with prepared_run(scene, ranks, options, report.print_plan) as runner:
            report.follow(runner)
            begin_steps()
            report.announce(folder)
            for _ in runner.steps():
                pass
            report.end(runner)
        assert runner.code is not None
        report.print_end(folder, runner.code)
        return runner.code
    except ONE_LINE_ERRORS as error:
        return print_error(error, args, ranks)


def _load(args: argparse.Namespace, ranks: SerialCommunicator) -> tuple[Scene, Path]:
    """Return the scene and its output folder. Raises SceneError, also for what refuses a run."""
    scene = load(args.scene, args.set)
    folder = args.output or scene.folder / scene.output.folder
    refusal = rank_refusal(args, ranks) or ("" if args.plan else folder_refusal(folder))
    if refusal and not args.check:
        raise SceneError([refusal])
    return scene, folder


def _preview(args: argparse.Namespace, ranks: SerialCommunicator) -> int:
    """Check, plan or prepare a scene, or measure this processor; return the exit code."""
    try:
        if args.scene is None:
            from .plan_command import calibrate

            return calibrate(ranks)
        scene, folder = _load(args, ranks)
        if args.check:
            from .check_command import check_scene

            return check_scene(scene)
        if args.prepare:
            return _prepare(scene, folder, args, ranks)
        from .plan_command import describe_plan

        text, needed = describe_plan(scene, folder, args, ranks)
        if text:
            print(text)
        refusal = memory_refusal(needed, ranks)
        return refuse([refusal], ranks) if refusal and not args.force else 0
    except ONE_LINE_ERRORS as error:
        return print_error(error, args, ranks)


def _prepare(
    scene: Scene, folder: Path, args: argparse.Namespace, ranks: SerialCommunicator
) -> int:
    """Generate the particles of a scene and stop; return the exit code."""
    from vgmpi.solver import initial_particles  # imported late, so that --check stays quick

    with run_lock.run_lock(folder, ranks, into=args.overwrite):
        summary = initial_particles.prepare(scene, ranks, folder)
        initial_particles.write_initial_particles(scene, summary, ranks, folder)
    if ranks.rank == 0:
        print(f"{sum(summary.count):,} particles in {folder / file_layout.GAUSSIANS}")
    return 0


def _inspect(path: Path) -> int:
    """Print what a file holds; return the exit code."""
    from vgmpi.preprocess import inspect_file  # a run does not need it

    try:
        print(
            inspect_file.describe_file(path)
            if inspect_file.is_inspectable(path)
            else run_reader.inspect(path)
        )
    except (run_reader.RunError, inspect_file.GaussianFileError, inspect_file.MeshError) as error:
        print(f"vgmpi: {error}", file=sys.stderr)
        return EXIT_USAGE
    return 0
