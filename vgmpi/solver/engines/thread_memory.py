"""Threads of a rank: their scratch memory, their shares of the work, and copies where they meet."""

import numpy as np

from vgmpi.kernels import particle_records
from vgmpi.kernels.grid import contact_impulses
from vgmpi.kernels.step_records import MAXIMA
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.planning.plan import Plan

from . import surface_fields
from .nodal_field_storage import NodalFields


class ThreadMemory:
    """Scratch memory of the threads, and what they report of a step.

    Attributes:
        scratch: Patches and records of particles.
        workspaces: Workspaces of contact at a node.
        stage_scratch: Scratch of the stages of features, see `FeaturePlan.stage_scratch`.
        reports: Maxima of the particles, shape (groups, threads, MAXIMA).
        overflow: Node block, counted from 1, in which a sum left its range, by thread and field.
    """

    def __init__(self, plan: Plan, threads: int, fields: NodalFields):
        """Allocate the memory.

        Args:
            plan: Plan of the run.
            threads: Number of threads.
            fields: Nodal fields.
        """
        patch_count = max(
            len(fields.gathered_nodes), any(each.correction_interval for each in plan.features),
            surface_fields.patch_count(plan),
        )  # fmt: skip
        phases = len(plan.phases)
        self.scratch = [particle_records.scratch(plan.real, patch_count) for _ in range(threads)]
        self.workspaces = [contact_impulses.contact_workspace(phases) for _ in range(threads)]
        self.stage_scratch = [_stage_scratch(plan) for _ in range(threads)]
        self.reports = np.zeros((len(plan.groups), threads, MAXIMA))
        self.overflow = np.zeros((threads, len(fields)), np.int64)


def _stage_scratch(plan: Plan) -> tuple:
    """Return scratch of a thread for the stages of features, () if they need none."""
    scratch = (feature.stage_scratch(len(plan.phases), plan.real) for feature in plan.features)
    return next((each for each in scratch if each is not None), ())


class ThreadPartition:
    """Rows per thread: all rows, rows at the border to other ranks, and inner rows."""

    def __init__(self, weights: np.ndarray, border: np.ndarray, threads: int):
        row = np.arange(len(weights))
        self.all = _split_by_weight(row, weights, threads)
        self.border = _split_by_weight(row[border], weights[border], threads)
        self.inner = _split_by_weight(row[~border], weights[~border], threads)

    def stage(self, border: bool) -> list[np.ndarray]:
        """Return the border rows or the inner rows of each thread."""
        return self.border if border else self.inner


def _split_by_weight(rows: np.ndarray, weights: np.ndarray, threads: int) -> list[np.ndarray]:
    """Split rows into consecutive arrays of about equal weight, one per thread."""
    cumulative = np.cumsum(weights)
    total = cumulative[-1] if len(cumulative) else 0
    cuts = np.searchsorted(cumulative, total * np.arange(1, threads) / threads)
    return np.split(rows, cuts)


def accumulator_copies(
    tables: ExchangeTopology,
    rows: list[np.ndarray],
    partitions: list[ThreadPartition],
    threads: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Assign separate rows of sums to threads that add to a node block at the same time.

    The first thread of a block needs no copy.

    Args:
        tables: Exchange topology of this rank.
        rows: Segments of each group in the tables.
        partitions: Partition of each group.
        threads: Number of threads.

    Returns:
        Target row of each segment, shape (segments, 27); the first copy of each node block, shape
        (node blocks + 1,); and the rows of all copies, which follow the rows of the node blocks.
    """
    count = len(tables.phase)
    target, first = tables.table.copy(), np.zeros(count + 1, np.int64)
    if threads == 1 or not count:
        return target, first, np.zeros(0, np.int64)
    used = np.zeros((2, threads, count), bool)  # (stage, thread, block); stages: border, inner
    parts = []
    for group_rows, partition in zip(rows, partitions, strict=True):
        for stage, split in enumerate((partition.border, partition.inner)):
            for k, local in enumerate(split):
                used[stage, k][tables.table[group_rows[local]].ravel()] = True
                parts.append((stage, k, group_rows[local]))
    is_shared = used.sum(1) > 1  # (2, node blocks)
    needs_copy = (used & is_shared[:, None]).any(0)  # (threads, node blocks)
    needs_copy[0] = False
    first[1:] = np.cumsum(needs_copy.sum(0))
    block, thread = np.nonzero(needs_copy.T)
    row = np.full((threads, count), -1)
    row[thread, block] = count + np.arange(len(block))
    for stage, k, local in parts:
        if k > 0:
            group_rows = tables.table[local]
            target[local] = np.where(is_shared[stage][group_rows], row[k][group_rows], group_rows)
    return target, first, count + np.arange(len(block))
