"""Rendering of the frames of a video by the ranks of MPI, which rank 0 gathers and writes."""

import contextlib
import pickle
from collections.abc import Generator
from typing import Any

import numpy as np

from vgmpi.io.run_reader import RunError

from . import image_io, render_config
from .frame_processes import Task
from .frame_renderer import FrameRenderer


class OtherRankError(RunError):
    """Error on ranks other than 0 if any rank has failed; rank 0 reports it."""


def run_on_all_ranks(ranks: Any, make) -> Any:
    """Return make() of this rank; if it fails on any rank, fail on all of them.

    Rank 0 raises the error of the lowest rank, the others OtherRankError. Collective.
    """
    result, error = None, None
    try:
        result = make()
    except (RunError, render_config.SettingsError, image_io.VideoError) as caught:
        error = caught
    failed = ranks.max(np.array([error is not None], dtype=np.int64))
    if failed[0]:
        errors = _at_root(ranks, error)
        raise OtherRankError() if errors is None else next(e for e in errors if e is not None)
    return result


def render_on_ranks(painter: FrameRenderer, ranks: Any, tasks: list[Task]) -> Generator:
    """Yield the views of the frames in order on rank 0, and as many Nones on the others.

    In each round every rank renders one frame and rank 0 gathers them: adjacent frames take nearly
    the same time. ranks: vgmpi.parallel.communicator. Collective.
    """
    if ranks.rank == 0:
        painter.look.colors.prepare(tasks[-1][0])
    ranks.barrier()
    for first in range(0, len(tasks), ranks.size):
        own_tasks = tasks[first + ranks.rank : first + ranks.rank + 1]
        views = run_on_all_ranks(
            ranks, lambda own_tasks=own_tasks: [painter.views_of(*task) for task in own_tasks]
        )
        gathered = _at_root(ranks, views)
        count = min(ranks.size, len(tasks) - first)
        try:
            yield from (
                [None] * count
                if gathered is None
                else (rank_views[0] for rank_views in gathered[:count])
            )
        except GeneratorExit:  # rank 0 cannot write, and the others wait in the next round
            if first + ranks.size < len(tasks):
                with contextlib.suppress(RunError):
                    run_on_all_ranks(ranks, _abort)
            raise


def _abort() -> None:
    """Raise the error of a failed write."""
    raise RunError("rank 0 cannot write")


def _at_root(ranks: Any, item: Any) -> list | None:
    """Gather the items of all ranks in rank order on rank 0. Collective."""
    data = np.frombuffer(pickle.dumps(item, protocol=5), dtype=np.uint8)
    sizes = ranks.all_rows(np.array([len(data)], dtype=np.int64))
    rows = ranks.gather_rows(data)
    if rows is None:
        return None
    ends = np.cumsum(sizes)
    return [pickle.loads(rows[end - size : end].tobytes()) for size, end in zip(sizes, ends)]
