"""Start of a run: on the cores of this machine that its scene pays for, by its predicted time."""

import argparse
import logging
import math
from typing import NamedTuple

from vgmpi.parallel.launch import launched_by
from vgmpi.planning.cost.run_estimate import predicted_seconds
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT
from vgmpi.planning.plan import make_plan, time_step_bounds
from vgmpi.preprocess import memory_estimate
from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.config.schema import SceneError
from vgmpi.runtime.process_limits import FreeCores, physical_cores
from vgmpi.scene.loader import load
from vgmpi.scene.objects import Object
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

from . import rank_supervisor
from .flags import is_run, parse_arguments
from .messages import log_to_stderr

log = logging.getLogger("vgmpi")

FREE_MARGIN = 0.3  # [cores] by which a core may be busy and count as free
# [s] by which ranks start later than one process (docs/benchmarks/performance.md#ranks-and-threads)
START_SECONDS = 1.5
MIN_GAIN = 0.9  # [-] of the time on one rank, above which ranks are not worth it
# A file's body is not read for this. Shares of the cube over a given height, and of the domain
# where only a scale is given, that captures and meshes are assumed to fill.
FILLED_CUBE, FILLED_DOMAIN = 0.3, 0.05


class CoreChoice(NamedTuple):
    """Number of ranks and why it is that."""

    ranks: int
    reason: str  # empty where all cores are used


class Start(NamedTuple):
    """Result of a start."""

    code: int | None  # exit code of the ranks; None if this process itself is to run
    words: list[str]  # words of the command line of a run in this process


def run_on_ranks(words: list[str]) -> Start:
    """Run a scene on ranks of this machine if it pays for them.

    Args:
        words: Words of the command line.
    """
    args = parse_arguments(words)
    if not is_run(args) or launched_by() or args.ranks == 1:
        return Start(None, words)
    log_to_stderr(args, first=True)
    if args.ranks is not None:
        return Start(_run_on_given_ranks(args, words), words)
    if args.threads > 1 or args.engine != "cpu":
        return Start(None, words)
    free, cores = FreeCores(), physical_cores()
    choice = _choose(args, cores, free)
    if choice.ranks == 1:
        if choice.reason:
            log.info("1 of %d cores: %s", cores, choice.reason)
        return Start(None, words)
    used, why = f"{choice.ranks} of {cores} cores", f"; {choice.reason}" * bool(choice.reason)
    mpirun = rank_supervisor.find_mpirun()
    try:
        if mpirun is None:
            raise rank_supervisor.LaunchError("there is no mpirun here")
        log.info("%s: %d ranks%s", used, choice.ranks, why)
        return Start(rank_supervisor.run_on_ranks(mpirun, choice.ranks, words), words)
    except rank_supervisor.LaunchError as error:
        log.info("%s: %d threads, since %s", used, choice.ranks, error)
        return Start(None, [*words, "--threads", str(choice.ranks)])


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


def choose_ranks(
    scene: Scene, cores: int, stop_steps: int = 0, stop_seconds: float = 0.0
) -> CoreChoice:
    """Return the number of ranks with which a run ends first.

    Args:
        scene: The scene.
        cores: Cores that this process may use.
        stop_steps: Steps after which the run stops, 0 for no limit.
        stop_seconds: Wall time after which the run stops [s], 0 for no limit.
    """
    if cores == 1:
        return CoreChoice(1, "")
    try:
        times = [
            predicted_run_seconds(scene, ranks, stop_steps) + (START_SECONDS if ranks > 1 else 0.0)
            for ranks in range(1, cores + 1)
        ]
    except SceneError:
        return CoreChoice(1, "the scene has errors")
    best = min(range(cores), key=lambda k: times[k])
    is_short = 0.0 < stop_seconds < 2.0 * START_SECONDS
    if is_short or times[best] > MIN_GAIN * times[0]:
        best = 0
    if best + 1 == cores:
        return CoreChoice(cores, "")
    return CoreChoice(best + 1, "the scene is too small for more (plan)")


def predicted_run_seconds(scene: Scene, ranks: int, stop_steps: int = 0) -> float:
    """Return the predicted time of a run from its start [s], before its particles are made.

    It is a lower bound: contact and partly filled blocks, which are not known yet, take three times
    as long again in a scene of tiny bodies.

    Args:
        scene: The scene.
        ranks: Number of ranks.
        stop_steps: Steps after which the run stops, 0 for no limit.

    Raises:
        SceneError: No time step satisfies the scene.
    """
    bodies = [expected_particles(scene, obj) for obj in scene.object]
    spacings = [memory_estimate.spacing_of(scene, obj) for obj in scene.object]
    for feature in features():
        for count, spacing in feature.particle_estimates(scene):
            bodies.append(count)
            spacings.append(spacing)
    volumes = [n * spacing**3 for n, spacing in zip(bodies, spacings, strict=True)]
    plan = make_plan(scene, bodies, volumes, any(obj.collider for obj in scene.object))
    pace = ASSUMED_THROUGHPUT[scene.accuracy.precision]
    seconds = predicted_seconds(scene, plan, ranks, pace)
    if stop_steps:
        dt = plan.time_step.fixed or time_step_bounds(scene, plan)[0][0]
        seconds *= min(1.0, stop_steps * dt / scene.time.end)
    return seconds


def expected_particles(scene: Scene, obj: Object) -> int:
    """Return about how many particles an object will have; none if it is scenery.

    Args:
        scene: The scene.
        obj: The object.
    """
    if obj.role != "body":
        return 0
    spacing = memory_estimate.spacing_of(scene, obj)
    if obj.shape is not None:
        return math.ceil(memory_estimate.approximate_particle_count(scene, obj))
    domain = math.prod(scene.domain.size)
    edge = obj.height or obj.width or obj.depth
    volume = FILLED_DOMAIN * domain if edge is None else min(FILLED_CUBE * edge**3, domain)
    return math.ceil(volume / spacing**3)
