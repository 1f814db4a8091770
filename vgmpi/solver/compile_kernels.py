"""Compilation of every kernel that a plan needs, or its loading from numba's cache."""

import contextlib
import logging
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.planning.particle_channels import SURFACE
from vgmpi.planning.plan import Plan
from vgmpi.runtime.cache_files import ON_EVERY_RANK
from vgmpi.runtime.compiled_kernels import compiled_marker, is_begun, precompiled_entry
from vgmpi.runtime.cpu_features import processor
from vgmpi.solver.diagnostics.conservation import body_momentum, conservation_rows

from .compile_helper import count_helpers, helpers_of
from .run_outcome import BlowUp
from .simulation import Simulation

log = logging.getLogger("vgmpi")

LINE_INTERVAL = 10.0  # [s] between lines on compiling where there is no terminal
WAIT_INTERVAL = 60.0  # [s] for which rank 1 waits for rank 0 before a line says so


def compile_kernels(plan: Plan, ranks: SerialCommunicator) -> None:
    """Make the kernels ready on every rank. Collective.

    Every rank compiles a share, with a bar on rank 0; a single rank has helpers on idle cores.
    Rank 0 then compiles what is left, so that the others find all in the cache; kernels that are
    already compiled are loaded by all ranks at once.

    Raises:
        BlowUp: On all ranks, if a test step with the kernels fails on rank 0.
    """
    _same_processor(ranks)
    marker = compiled_marker([type(group.law) for group in plan.groups], plan.real)
    ready = ranks.bcast(marker.exists())
    if ranks.rank == 0 and not ready:
        log.info("compiling for this processor, once for these materials: a minute or two")
    helpers = 0 if ready else count_helpers(ranks.size)
    with helpers_of(plan, helpers):
        if not ready:
            compile_share(plan, ranks.rank, ranks.size + helpers, ranks.rank == 0)
        failure = _failure_of_run(plan) if ranks.rank == 0 or ready else ""
    with _announced_wait(ranks):
        failure = ranks.bcast(failure)  # the others wait here while rank 0 compiles
    if failure:
        raise BlowUp(f"before the first step, a particle of every object in one place: {failure}")
    if ranks.rank == 0:
        with contextlib.suppress(OSError):  # an unwritable folder holds no code either
            marker.parent.mkdir(parents=True, exist_ok=True)
            marker.touch()
    elif not ready:
        _run_all(plan)


@contextlib.contextmanager
def _announced_wait(ranks: SerialCommunicator) -> Iterator[None]:
    """Log, on rank 1 alone, that rank 0 is waited for if that takes WAIT_INTERVAL."""

    def announce() -> None:
        """Log the line."""
        seconds = f"{WAIT_INTERVAL:.0f} s"
        log.log(ON_EVERY_RANK, "rank 1 waits for rank 0, which compiles: %s so far", seconds)

    timer = threading.Timer(WAIT_INTERVAL, announce)
    timer.daemon = True
    if ranks.rank == 1:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


def is_compiled(plan: Plan) -> bool:
    """Return whether the kernels of a plan are in the cache."""
    return compiled_marker([type(group.law) for group in plan.groups], plan.real).exists()


def _same_processor(ranks: SerialCommunicator) -> None:
    """Warn if code is compiled for different processors, whose sums round differently."""
    local = np.frombuffer(processor().encode().ljust(96)[:96], np.uint8)
    kinds = [bytes(row).decode().strip() for row in ranks.all_rows(local[None])]
    if len(set(kinds)) > 1:
        first_rank = {kind: kinds.index(kind) for kind in kinds}
        log.warning(
            "the processors of this job differ (%s): every rank rounds in its own way, and the bits"
            " are not those of other runs. To have them equal, set NUMBA_CPU_NAME and"
            " NUMBA_CPU_FEATURES to a kind that all can run (docs/benchmarks/performance.md)",
            ", ".join(f"rank {rank}: {kind}" for kind, rank in first_rank.items()),
        )


def compile_share(plan: Plan, share: int, shares: int, visible: bool) -> None:
    """Compile kernels that no other process has begun, each starting at another one.

    A step without its kernels tells what they are called with. What fails here is reported when the
    kernels are run.

    Args:
        plan: The plan.
        share: Number of this process among those that compile.
        shares: Number of these processes.
        visible: Whether this process shows its progress.
    """
    calls: list[tuple] = []
    try:
        _run_all(plan, calls)
    except Exception as error:  # a step may fail without its kernels
        log.debug("not all kernels are compiled side by side: %s", error)
    first = share * len(calls) // shares
    try:
        for call in _followed(calls[first:] + calls[:first], visible):
            if not is_begun(*call):
                precompiled_entry(*call)
    except Exception as error:
        log.debug("not all kernels are compiled side by side: %s", error)


def _followed(calls: list[tuple], visible: bool) -> Iterator[tuple]:
    """Yield kernel calls with a bar on a terminal, or with a line every ten seconds.

    Args:
        calls: Kernels to compile, with their arguments.
        visible: Whether this rank shows anything.
    """
    begun = last_line = time.monotonic()
    is_bar = visible and sys.stderr.isatty() and log.isEnabledFor(logging.INFO)
    for count, call in enumerate(
        tqdm(calls, "compiling", unit="kernel", leave=False, disable=not is_bar)
    ):
        now = time.monotonic()
        if visible and not is_bar and now - last_line > LINE_INTERVAL:
            last_line = now
            log.info("compiling: %d of %d kernels, %.0f s so far", count, len(calls), now - begun)
        yield call


def _failure_of_run(plan: Plan) -> str:
    """Run `_run_all`; return the reason if it fails, else ""."""
    try:
        _run_all(plan)
    except BlowUp as error:
        return str(error)
    return ""


def _run_all(plan: Plan, calls: list[tuple] | None = None) -> None:
    """Take one particle per object through a step, a sort and the conservation log.

    Released bodies are run again in the groups that they join.

    Args:
        plan: The plan.
        calls: If given, the kernels of the step are not called but appended, with their arguments.
    """
    _run(plan, calls)
    groups = dict(enumerate(plan.group_of))
    for feature in plan.features:
        groups |= feature.groups_after_release()
    if (group_of := tuple(groups.values())) != plan.group_of:
        _run(replace(plan, group_of=group_of), calls)


def _run(plan: Plan, calls: list[tuple] | None) -> None:
    """Run all kernels of a plan once, or append those of the step to `calls`."""
    middle = 0.5 * np.array(plan.cells) * plan.dx
    owners = np.array([k for k, g in enumerate(plan.group_of) if g >= 0 and plan.count[k]], int)
    features = [each.for_compilation() for each in plan.features]
    plan = replace(plan, features=tuple(each for each in features if each))
    simulation = Simulation(plan, SerialCommunicator())
    if calls is not None:
        vars(simulation.engine)["call_if_rows"] = lambda key, *call: calls.append(call)
    n = len(owners)
    ids = np.array(plan.first_id)[owners]
    simulation.put(
        np.tile(middle, (n, 1)), np.zeros((n, 3)), np.full(n, plan.dx**3), ids, owners,
        surface=np.zeros((n, SURFACE)),
    )  # fmt: skip
    dt = 1e-6 * simulation.bound()
    simulation.advance(dt)
    own = max((feature.correction_interval for feature in plan.features), default=0)
    if plan.correction_interval or own:
        simulation.correct_transfers(dt, own > 0)
    if own and plan.correction_interval not in (0, own):
        simulation.correct_transfers(dt)
    conservation_rows(simulation)
    for feature in simulation.features.values():
        feature.compile_kernels()
    for group in simulation.groups:
        body_momentum(simulation, group, 0, 0)
    empty, masks = np.zeros(0, np.uint64), np.zeros(0, np.uint64)
    for name in simulation.exchange.needs.layers:
        part = FieldMessage(name, np.zeros(0, np.int64), masks, empty, np.zeros(0, np.uint16))
        simulation.engine.pack(part)
        simulation.engine.add(part)
