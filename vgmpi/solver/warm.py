"""Compile every kernel a plan needs, or load it from numba's cache, before the first step."""

import contextlib
import logging
from dataclasses import replace

import numpy as np

from ..device.processor import processor, stamp
from ..domain.halo import Part
from ..domain.ranks import Alone
from ..kernels.push import push
from ..planning.channels import SURFACE
from ..planning.plan import Plan
from .step import BlowUp, Simulation
from .watch import about, ledger

log = logging.getLogger("vgmpi")


def warm(plan: Plan, ranks: Alone) -> None:
    """Have the kernels ready on every rank. Collective.

    Rank 0 compiles them first, so that the others find them in the cache; what is compiled already
    all ranks load at once. Raises BlowUp on all ranks where a step with them goes wrong on rank 0.
    """
    _same_processor(ranks)
    there = stamp([type(group.law) for group in plan.groups], plan.real)
    ready = ranks.bcast(there.exists())
    if ranks.rank == 0 and not ready:
        log.info("compiling for this processor, once for these materials: a minute or two")
    wrong = _tried(plan) if ranks.rank == 0 or ready else ""
    wrong = ranks.bcast(wrong)  # the others wait here for what rank 0 compiles
    if wrong:
        raise BlowUp(f"before the first step, a particle of every object in one place: {wrong}")
    if ranks.rank == 0:
        with contextlib.suppress(OSError):  # a folder that cannot be written holds no code either
            there.parent.mkdir(parents=True, exist_ok=True)
            there.touch()
    elif not ready:
        _run_all(plan)


def _same_processor(ranks: Alone) -> None:
    """Warn where code is compiled for different processors: sums would round differently."""
    mine = np.frombuffer(processor().encode().ljust(96)[:96], np.uint8)
    kinds = [bytes(row).decode().strip() for row in ranks.all_rows(mine[None])]
    if len(set(kinds)) > 1:
        first = {kind: kinds.index(kind) for kind in kinds}
        log.warning(
            "the processors of this job differ (%s): every rank rounds in its own way, and the bits"
            " are not those of other runs. To have them equal, set NUMBA_CPU_NAME and"
            " NUMBA_CPU_FEATURES to a kind that all can run (docs/performance.md)",
            ", ".join(f"rank {rank}: {kind}" for kind, rank in first.items()),
        )


def _tried(plan: Plan) -> str:
    """What went wrong in `_run_all`; "" if nothing did."""
    try:
        _run_all(plan)
    except BlowUp as error:
        return str(error)
    return ""


def _run_all(plan: Plan) -> None:
    """A particle per object through one step, a sort and the ledger; also of each that is let go
    in the run."""
    _run(plan)
    if plan.driven:
        group_of = list(plan.group_of)
        for one in plan.driven:
            for k in one.things:
                group_of[k] = one.joins
        _run(replace(plan, group_of=tuple(group_of)))


def _run(plan: Plan) -> None:
    middle = 0.5 * np.array(plan.cells) * plan.dx
    things = np.array([k for k, g in enumerate(plan.group_of) if g >= 0 and plan.count[k]])
    alone = Simulation(replace(plan, sources=(), sinks=()), Alone())
    n = len(things)
    ids = np.array(plan.first_id)[things]
    alone.put(
        np.tile(middle, (n, 1)), np.zeros((n, 3)), np.full(n, plan.dx**3), ids, things,
        surface=np.zeros((n, SURFACE)),
    )  # fmt: skip
    alone.advance(1e-6 * alone.bound())
    if plan.restores:
        alone.restore(1e-6 * alone.bound())
    ledger(alone)
    for group in alone.groups:
        push(group.f, np.zeros(0, np.int64), np.zeros(3, plan.real))
        about(alone, group, 0, 0)
    empty, masks = np.zeros(0, np.uint64), np.zeros(0, np.uint64)
    for name in alone.needs.layers:
        part = Part(name, np.zeros(0, np.int64), masks, empty, np.zeros(0, np.uint16))
        alone.engine.pack(part)
        alone.engine.add(part)
