"""Options of a run, the engines by their names, and checks before any work is done."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.runtime.process_limits import available_cores
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features
from vgmpi.solver.engines.cpu import Cpu
from vgmpi.solver.engines.engine_protocol import Engine
from vgmpi.solver.engines.numpy_reference.reference_engine import Numpy

from .run_outcome import InvalidRunOptions

log = logging.getLogger("vgmpi")


@dataclass
class Options:
    """Options of a run beyond what the scene says."""

    folder: Path | None  # None: nothing is written
    threads: int = 1
    engine: str = "cpu"  # name of an engine, see `engine_of`
    resume: str | None = None  # a checkpoint's path; "": the newest valid one; None: from the start
    stop_steps: int = 0  # [steps] of this run until it stops, 0 for no limit
    stop_seconds: float = 0.0  # [s] wall time until it stops, 0 for no limit
    overwrite: bool = False  # replace an existing run in the folder
    change: bool = False  # resume although the scene has changed
    steered: bool = False  # whether a program may ask for a stop after any step
    listeners: list = field(default_factory=list)  # each called with (simulation) after every step
    watchers: list = field(default_factory=list)  # each called with (run) at every frame


ENGINES: dict[str, type[Engine]] = {"cpu": Cpu, "numpy": Numpy}  # engines of every machine
CARD = "cuda"  # needs a GPU and the extra of that name
MAX_THREADS_PER_CORE, MIN_THREAD_LIMIT = 4, 32  # more would take memory for nothing


def engine_of(name: str) -> type[Engine]:
    """Return the engine class of a name; the CUDA engine is imported only when it is named."""
    if name == CARD:
        from vgmpi.solver.engines.cuda.cuda_engine import Cuda

        return Cuda
    return ENGINES[name]


def check(options: Options, ranks: SerialCommunicator) -> None:
    """Raise InvalidRunOptions before any work is done for options that cannot run."""
    if options.engine not in (*ENGINES, CARD):
        raise InvalidRunOptions(
            f"engine must be one of {', '.join((*ENGINES, CARD))}; got {options.engine!r}"
        )
    if options.threads < 1:
        raise InvalidRunOptions(f"threads must be at least 1; got {options.threads}")
    limit = max(MIN_THREAD_LIMIT, MAX_THREADS_PER_CORE * available_cores())
    if options.threads > limit:
        raise InvalidRunOptions(
            f"threads must be at most {limit} where this process may use {available_cores()} cores;"
            f" got {options.threads}"
        )
    if options.engine == "numpy" and (ranks.size > 1 or options.threads > 1):
        raise InvalidRunOptions(
            "engine numpy computes on one rank and one thread; asked for"
            f" {ranks.size} x {options.threads}"
        )
    if options.engine == CARD:
        _find_card(options, ranks)


def suit_engine(engine: str, scene: Scene, ranks: SerialCommunicator) -> Scene:
    """Return a scene without chosen defaults that an engine lacks; rank 0 logs a line on them.

    Args:
        engine: Name of the engine.
        scene: The scene.
        ranks: Communicator.

    Raises:
        InvalidRunOptions: The scene itself has what the engine lacks: the message names all of it.
    """
    lacking = [feature for feature in features() if engine in feature.missing_engines]
    choices = {key: value for each in lacking for key, value in each.chosen_keys.items()}
    suited = scene.with_choices(choices)
    check_engine(engine, suited)
    if suited is not scene and ranks.rank == 0:
        now, before = suited.accuracy, scene.accuracy
        keys = [key for key in choices if getattr(now, key) != getattr(before, key)]
        changed = ", ".join(f"accuracy.{key} = {getattr(now, key)!r}" for key in keys)
        log.info("engine %s runs this scene with %s", engine, changed)
    return suited


def check_engine(engine: str, scene: Scene) -> None:
    """Raise InvalidRunOptions, which names all of it, if a scene has what its engine lacks."""
    absent = [
        f"no {title}: {scene.place(path)}"
        for feature in features()
        if engine in feature.missing_engines
        for title, path in feature.named_parts(scene)
    ]
    if absent:
        raise InvalidRunOptions(f"engine {engine} has {', '.join(absent)}; engine cpu has")


def _find_card(options: Options, ranks: SerialCommunicator) -> None:
    """Choose this rank's GPU; raise InvalidRunOptions on all ranks if one of them has none."""
    problem = f"engine cuda has no threads; asked for {options.threads}"
    if options.threads == 1:
        try:
            from vgmpi.solver.engines.cuda import graphics_card

            problem = graphics_card.select_device(ranks.place, ranks.rank)
        except ImportError as error:
            problem = f"engine cuda needs `pip install 'vgmpi[cuda]'`: {error}"
    missing = ranks.all_rows(np.array([[ranks.rank]] if problem else np.zeros((0, 1)), np.int64))
    if len(missing):
        first = int(missing.min())
        raise InvalidRunOptions(
            ranks.bcast(problem) or f"engine cuda finds no card on rank {first}"
        )
