"""Rendering of the frames of a video by several processes of one machine, or by the ranks of MPI.

The processes end with the one that started them, however it ends: an idle one finds its pipe
closed, and one that draws gets a signal from the system (Linux) or is ended by a thread that waits
for the other process.
"""

import contextlib
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Generator, Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.runtime.compiled_kernels import call_at_first_compilation
from vgmpi.runtime.death_signal import die_with_parent
from vgmpi.runtime.process_limits import physical_cores

from . import image_io, render_config
from .frame_renderer import FrameRenderer, RenderedView
from .prepared_run import open_run

Task = tuple[int, float]  # a frame's number and its part of the video
SMALLEST = 16  # [pixels] longer side of a picture that is drawn to compile what draws it
AHEAD = 2  # [frames per process] that may be drawn before the next one in order is


def render_in_processes(
    painter: FrameRenderer, settings_folder: Path, tasks: list[Task], jobs: int
) -> Generator:
    """Yield the views of the frames in order, rendered by several processes.

    Args:
        painter: Renderer of this process.
        settings_folder: Folder of render.toml.
        tasks: Frames.
        jobs: Number of processes.

    Raises:
        RunError: Also if one of the processes was ended from outside.
    """
    jobs = min(jobs, len(tasks))
    if jobs <= 1:
        yield from (painter.views_of(*task) for task in tasks)
        return
    painter.look.colors.prepare(tasks[-1][0])
    options = {"alpha": painter.alpha, "depth": painter.depth, "draft": painter.draft}
    start = (str(painter.run.folder), painter.chosen, settings_folder, options)
    with _started(jobs, start) as pipes:
        yield from _in_order(pipes, tasks)


def _in_order(pipes: list[Connection], tasks: list[Task]) -> Iterator[list[RenderedView]]:
    """Hand out the tasks and yield their results in order."""
    busy: dict[Connection, int] = {}  # number of the task of each process that draws
    done: dict[int, list[RenderedView]] = {}
    first, issued = 0, 0
    while first < len(tasks):
        for pipe in pipes:
            if pipe not in busy and issued < min(first + AHEAD * len(pipes), len(tasks)):
                busy[pipe] = issued
                _send(pipe, tasks[issued])
                issued += 1
        ready = wait(list(busy))
        for pipe in [pipe for pipe in busy if pipe in ready]:
            done[busy.pop(pipe)] = _result(pipe)
        while first in done:
            yield done.pop(first)
            first += 1


def _send(pipe: Connection, task: Task) -> None:
    """Send a task to a process. Raises RunError if the process has ended."""
    try:
        pipe.send(task)
    except OSError:
        raise _ended() from None


def _result(pipe: Connection) -> list[RenderedView]:
    """Receive a result; raise the error of the process instead if it had one."""
    try:
        result, error = pipe.recv()
    except (EOFError, OSError):
        raise _ended() from None
    if error is not None:
        raise error
    return result


def _ended() -> RunError:
    """Return the error for a process that ended by itself."""
    return RunError("a process that draws frames was ended: out of memory? --jobs 1 needs less")


@contextlib.contextmanager
def _started(jobs: int, start: tuple) -> Iterator[list[Connection]]:
    """Start processes and give their pipes; end the processes at the end."""
    context = multiprocessing.get_context("spawn")  # forked processes would share open files
    processes: list[Any] = []
    pipes: list[Connection] = []
    try:
        # Ctrl-C reaches the processes too, and this one alone reacts to it: they inherit the mask
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            for _ in range(jobs):
                own, other = context.Pipe()
                process = context.Process(target=_work, args=(other, *start), daemon=True)
                process.start()
                other.close()
                processes.append(process)
                pipes.append(own)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield pipes
    finally:
        for process in processes:
            process.kill()  # they write no files of the user
        for process in processes:
            process.join()
        for pipe in pipes:
            pipe.close()


def _work(
    pipe: Connection, folder: str, chosen: render_config.Settings, settings_folder: Path,
    options: dict,
) -> None:  # fmt: skip
    """Draw the frames that the other process asks for until it closes the pipe."""
    end_with_parent()
    logging.disable(logging.WARNING)  # the first process has logged it already
    painter: FrameRenderer | None = None
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        reply: tuple[Any, Any]
        try:
            if painter is None:
                painter = FrameRenderer(RunReader(folder), chosen, settings_folder, **options)
            reply = painter.views_of(*task), None
        except Exception as error:
            error.add_note(traceback.format_exc())
            reply = None, error
        try:
            pipe.send(reply)
        except OSError:
            return


@contextlib.contextmanager
def compiled_beside(painter: FrameRenderer, settings_folder: Path) -> Iterator[None]:
    """Let another core compile what a picture of the studio needs last, while its first is drawn.

    A process is started only if something is to be compiled in the block; it ends with the block.

    Args:
        painter: Renderer of this process.
        settings_folder: Folder of render.toml.
    """
    processes: list[Any] = []
    is_over = False

    def start() -> None:
        """Start the process."""
        if not is_over:
            process = multiprocessing.get_context("spawn").Process(
                target=_draw_nothing,
                args=(str(painter.run.folder), painter.chosen, settings_folder, painter.quick),
                daemon=True,
            )
            process.start()
            processes.append(process)

    if painter.studio is not None and physical_cores() > 1:
        call_at_first_compilation(start)
    try:
        yield
    finally:
        is_over = True
        for process in processes:
            process.kill()  # what it has compiled is on disk
            process.join()


def _draw_nothing(
    folder: str, chosen: render_config.Settings, settings_folder: Path, quick: bool
) -> None:
    """Draw a picture without particles, for which the same functions are compiled."""
    end_with_parent()
    logging.disable()
    size = SMALLEST if quick else None
    FrameRenderer(open_run(folder, prepared=True), chosen, settings_folder, longest=size).warm_up()


def end_with_parent() -> None:
    """Make this process end when the one that started it does, even by SIGKILL."""
    parent = multiprocessing.parent_process()
    assert parent is not None and parent.pid is not None
    if sys.platform == "linux":
        die_with_parent(signal.SIGKILL)()
        if os.getppid() != parent.pid:  # it ended before
            os._exit(1)

    def wait_for_parent() -> None:
        """End this process as soon as the other one has ended."""
        parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_parent, daemon=True).start()


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
