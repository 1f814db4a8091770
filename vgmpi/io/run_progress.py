"""Progress of a run as its folder tells it, and a request to stop it with a checkpoint."""

import contextlib
import math
import os
import signal
import socket
import time
from pathlib import Path
from typing import NamedTuple

from vgmpi.runtime.message_text import format_duration

from . import file_layout, run_lock
from .run_lock import RunWriter
from .run_reader import RunError, RunReader

PACE_FRAMES = 10  # frames over which the pace is measured
STOP_SIGNAL = signal.SIGUSR1  # a run stops with a checkpoint (docs/how-to/stop-and-resume.md)


class RunProgress(NamedTuple):
    """Progress of a run at its newest frame."""

    frame: int  # number of the newest frame
    frame_count: int | None  # frames of the whole run, None if unknown
    time: float  # simulated time of the newest frame [s]
    end: float | None  # simulated time of the end [s], None if unknown
    step: int  # steps made up to the newest frame
    steps_per_second: float  # of wall time [1/s]; nan if unknown
    remaining: float  # wall time to the end [s]; nan if unknown
    writer: RunWriter | None  # run that writes into the folder now
    blew_up: bool  # whether the folder holds the state of a blow-up

    def lines(self) -> list[str]:
        """Return the progress as lines of text."""
        is_complete = self.end is not None and self.time >= self.end * (1 - 1e-9)
        if self.writer is not None:
            state = f"running: {self.writer}"
        elif self.blew_up:
            state = "ended: blew up"
        else:
            state = "ended: complete" if is_complete else "no run writes here now"
        of_frames = "" if self.frame_count is None else f" of 0..{self.frame_count - 1}"
        of_end = "" if self.end is None else f" of {self.end:.4g} s"
        lines = [
            state,
            f"newest frame {self.frame}{of_frames}, {self.time:.4g}{of_end or ' s'}",
            f"step {self.step:,}",
        ]
        if self.writer is not None and not math.isnan(self.steps_per_second):
            lines[-1] += f", {self.steps_per_second:.3g} steps per second"
        if self.writer is not None and not math.isnan(self.remaining):
            lines.append(f"about {format_duration(self.remaining)} left")
        return lines


def read_progress(reader: RunReader) -> RunProgress:
    """Return the progress of a run. Raises RunError.

    The pace is that of the last PACE_FRAMES frames by the times at which their files were written.
    Frames from before a restart do not count.
    """
    numbers, writer = sorted(reader.frames), run_lock.find_writer(reader.folder)
    last, recent = numbers[-1], numbers[-PACE_FRAMES - 1 :]
    try:
        wall_of = {number: reader.path(number).stat().st_mtime for number in recent}
    except OSError as error:
        raise RunError(f"{error.filename}: {error.strerror}") from None
    begin = 0.0  # [s] time at which the process began that writes now
    with contextlib.suppress(OSError):  # its lock may have gone meanwhile
        begin = (reader.folder / file_layout.LOCK).stat().st_mtime if writer else 0.0
    first = next((number for number in recent if wall_of[number] >= begin), last)
    now, step = reader.time_and_step(last)
    before, first_step = reader.time_and_step(first)
    written, wall = wall_of[last], wall_of[first]
    duration, advance = written - wall, now - before
    end, frame_count = _planned_end(reader)
    pace = remaining = math.nan
    if duration > 0 and advance > 0:
        pace = (step - first_step) / duration
        if end is not None:
            simulated_ahead = max(end - now, 0.0) * duration / advance
            remaining = max(simulated_ahead - max(time.time() - written, 0.0), 0.0)
    return RunProgress(
        last, frame_count, now, end, step, pace, remaining, writer,
        any((reader.folder / file_layout.BLOWUP).glob(f"{file_layout.FRAMES}/*.vtkhdf")),
    )  # fmt: skip


def _planned_end(reader: RunReader) -> tuple[float | None, int | None]:
    """Return the simulated time of the run's end [s] and its frames, None if unknown."""
    try:
        table = reader.scene["time"]
        return float(table["end"]), int(table["frames"])
    except (KeyError, TypeError, ValueError):
        return None, None


def request_stop(folder: Path) -> tuple[bool, str]:
    """Ask the run that writes into a folder to stop with a checkpoint.

    The signal is sent only to a process of this machine that holds the folder's lock file open and
    handles the signal, because a lock file can name any process.

    Args:
        folder: Output folder of the run.

    Returns:
        Whether the request was sent, and one line about it.
    """
    lock = folder / file_layout.LOCK
    writer = run_lock.find_writer(folder)
    if writer is None:
        return False, f"{folder}: no run writes here now, so there is nothing to stop"
    host = socket.gethostname()
    if writer.host != host:
        remedy = f"there, `kill -{STOP_SIGNAL.name[3:]} {writer.pid}` stops it"
        return False, f"the run is process {writer.pid} on {writer.host}, not on {host}: {remedy}"
    try:
        if not _holds_file(writer.pid, lock):
            return False, f"process {writer.pid} does not hold {lock}: nothing was sent"
        if not _handles_signal(writer.pid, STOP_SIGNAL):
            message = f"process {writer.pid} does not handle {STOP_SIGNAL.name}: nothing was sent"
            return False, message
        os.kill(writer.pid, STOP_SIGNAL)
    except OSError as error:
        return False, f"process {writer.pid}: {error.strerror}: nothing was sent"
    return True, f"process {writer.pid} was asked to stop with a checkpoint"


def _holds_file(pid: int, path: Path) -> bool:
    """Return whether a process of this machine has a file open. Raises OSError."""
    target = os.stat(path, follow_symlinks=False)
    for entry in os.scandir(f"/proc/{pid}/fd"):
        try:
            if os.path.samestat(os.stat(entry.path), target):
                return True
        except OSError:  # it was closed meanwhile
            continue
    return False


def _handles_signal(pid: int, number: signal.Signals) -> bool:
    """Return whether a process of this machine has a handler for a signal. Raises OSError."""
    with open(f"/proc/{pid}/status") as status:
        masks = [line.split()[1] for line in status if line.startswith("SigCgt:")]
    return bool(masks) and bool(int(masks[0], 16) >> (number - 1) & 1)
