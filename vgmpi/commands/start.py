"""Start of a run: on the cores of this machine that its scene pays for.

Only a command line comes here. `cli.main` and the Python interface start no processes.
"""

import argparse
import logging
import math
import os

from vgmpi.parallel.launch import launched_by
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.config.schema import SceneError
from vgmpi.runtime.process_limits import FreeCores, physical_cores
from vgmpi.scene.loader import load

from . import cli, rank_supervisor
from .core_choice import CoreChoice, choose_ranks
from .flags import parse_arguments

log = logging.getLogger("vgmpi")

FREE_MARGIN = 0.3  # [cores] by which a core may be busy and count as free


def main(words: list[str]) -> int:
    """Run the command; return the exit code.

    Args:
        words: Words of the command line.
    """
    name = os.environ.pop(rank_supervisor.SOCKET_VARIABLE, None)
    if name is not None:
        return rank_supervisor.run_as_rank(name, cli.main, words)
    args = parse_arguments(words)
    if not cli.is_run(args) or launched_by() or args.ranks == 1:
        return cli.main(words)
    cli.log_to_stderr(args, first=True)
    if args.ranks is not None:
        return _run_on_given_ranks(args, words)
    if args.threads > 1 or args.engine != "cpu":
        return cli.main(words)
    free, cores = FreeCores(), physical_cores()
    choice = _choose(args, cores, free)
    if choice.ranks == 1:
        if choice.reason:
            log.info("1 of %d cores: %s", cores, choice.reason)
        return cli.main(words)
    used, why = f"{choice.ranks} of {cores} cores", f"; {choice.reason}" * bool(choice.reason)
    mpirun = rank_supervisor.find_mpirun()
    try:
        if mpirun is None:
            raise rank_supervisor.LaunchError("there is no mpirun here")
        log.info("%s: %d ranks%s", used, choice.ranks, why)
        return rank_supervisor.run_on_ranks(mpirun, choice.ranks, words)
    except rank_supervisor.LaunchError as error:
        log.info("%s: %d threads, since %s", used, choice.ranks, error)
        return cli.main([*words, "--threads", str(choice.ranks)])


def _run_on_given_ranks(args: argparse.Namespace, words: list[str]) -> int:
    """Run on the ranks that were asked for; return the exit code."""
    mpirun = rank_supervisor.find_mpirun()
    try:
        if mpirun is None:
            raise rank_supervisor.LaunchError("there is no mpirun (docs/tutorial/install.md)")
        log.info("%d ranks on %d cores", args.ranks, physical_cores())
        return rank_supervisor.run_on_ranks(mpirun, args.ranks, words)
    except rank_supervisor.LaunchError as error:
        log.error("--ranks %d: %s", args.ranks, error)
        return EXIT_USAGE


def _choose(args: argparse.Namespace, cores: int, free: FreeCores) -> CoreChoice:
    """Return the choice of ranks for a run; one rank where its scene has errors.

    Ranks that share cores with other programs wait for each other at every step: two ranks
    took many times as long as one on two busy cores. So only free cores are taken.

    Args:
        args: Flags of the run.
        cores: Cores that this process may use.
        free: Meter of free cores, begun before.
    """
    if cores == 1:
        return CoreChoice(1, "")
    try:
        scene = load(args.scene, args.set)
    except SceneError:
        return CoreChoice(1, "")  # the run prints what is wrong
    choice = choose_ranks(scene, cores, args.stop_steps, args.stop_seconds)
    if choice.ranks == 1:
        return choice
    usable = max(1, math.floor(min(free.measure() + FREE_MARGIN, cores)))
    if usable >= choice.ranks:
        return choice
    hint = f"other programs use the rest (--ranks {choice.ranks} takes them all the same)"
    return CoreChoice(usable, hint)
