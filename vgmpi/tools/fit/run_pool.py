"""Pool of the runs of a fit, each in a folder named by its parameters.

A run that is complete is not made again, so that an interrupted fit continues with the same
result. Several processes may share the runs; each makes those that no other has begun.
"""

import functools
import hashlib
import json
import os
import shutil
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from vgmpi.api import run
from vgmpi.io import file_layout
from vgmpi.io.hdf5_writer import StoreError, replace_text
from vgmpi.io.run_lock import RunFolderInUseError, file_lock
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.tradeoff_results import fingerprint
from vgmpi.runtime.command_line import DENIED, FULL
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.run_outcome import BLEW_UP, DONE, BlowUp
from vgmpi.tools.tradeoff.parameter_sweep import Setting
from vgmpi.tools.tradeoff.study_runs import StudyError, run_program

RECORD = "fit.json"
POLL_SECONDS = 0.1  # [s] interval of checks for runs that other processes make


@dataclass(frozen=True)
class CompletedRun:
    """A run that has ended: its folder, its wall time [s], and whether it completed.

    A run that blew up is not completed.
    """

    folder: Path
    seconds: float
    completed: bool


class RunPool:
    """Runs of a scene below `folder`, `jobs` at a time, on `ranks` MPI ranks each.

    With one job and one rank the runs are made in this process, without the start of another.
    """

    def __init__(self, scene: Scene, folder: Path, ranks: int = 1, jobs: int = 1):
        self.scene, self.folder, self.ranks, self.jobs = scene, folder, ranks, jobs

    def place(self, setting: Setting) -> Path:
        """Return the folder of a run."""
        return self.folder / fingerprint(self.scene, (*setting.overrides, *self._contents))

    @functools.cached_property
    def _contents(self) -> tuple[str, ...]:
        """Digests of the files that the scene names, such as meshes and captures.

        A run with other contents has another folder. Raises StudyError.
        """
        digests = []
        for name, path in sorted(self.scene.files.items()):
            try:
                with open(path, "rb") as file:
                    digests.append(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}")
            except OSError as error:
                raise StudyError(f"{path}: {error.strerror or error}") from None
        return tuple(digests)

    def done(self, setting: Setting) -> CompletedRun | None:
        """Return the run of a setting if it has ended and belongs to the present scene."""
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record["set"] == list(setting.overrides):
                return CompletedRun(
                    self.place(setting), float(record["seconds"]), bool(record["whole"])
                )
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def all(self, settings: list[Setting]) -> Iterator[CompletedRun]:
        """Yield the runs of all settings in order, each as soon as it has ended.

        A run is made here, or by another process that shares the folder.

        Raises:
            StudyError: If a run cannot be made.
        """
        stopped = threading.Event()
        pending = [setting for setting in dict.fromkeys(settings) if self.done(setting) is None]
        if self.jobs == 1:
            for setting in settings:
                while (run := self.done(setting)) is None:
                    self._next(pending)
                yield run
            return
        with ThreadPoolExecutor(self.jobs) as pool:
            workers = [pool.submit(self._work, pending, stopped) for _ in range(self.jobs)]
            try:
                for setting in settings:
                    while (run := self.done(setting)) is None:
                        _raise_failure(workers)
                        time.sleep(POLL_SECONDS)
                    yield run
            finally:
                stopped.set()

    def _work(self, pending: list[Setting], stopped: threading.Event) -> None:
        """Make runs in one of several threads until none is pending or `stopped` is set."""
        while not stopped.is_set() and any(self.done(setting) is None for setting in pending):
            self._next(pending)

    def _next(self, pending: list[Setting]) -> None:
        """Make the first run that has neither ended nor begun; wait briefly if there is none.

        A run whose process was killed counts as not begun, because the system releases its lock.
        """
        for setting in pending:
            if self.done(setting) is None and self._claim(setting):
                return
        time.sleep(POLL_SECONDS)

    def _claim(self, setting: Setting) -> bool:
        """Make a run unless another process is making it; return whether it was free."""
        folder = self.place(setting)
        try:
            with file_lock(folder.with_name(f"{folder.name}.lock")) as handle:
                if handle is None:
                    return False
                os.listdir(folder.parent)  # NFS: this refreshes the cached directory
                if self.done(setting) is None:  # another process may have completed it meanwhile
                    self._make(setting, handle)
                return True
        except OSError as error:
            if error.errno in (*FULL, *DENIED):
                error.filename = error.filename or str(folder)
                raise  # the command prints it
            raise StudyError(f"{folder}: {error.strerror or error}") from None

    def _make(self, setting: Setting, handle: int) -> None:
        """Make a run, in this process or in another one, and write its record."""
        folder = self.place(setting)
        (folder / RECORD).unlink(missing_ok=True)
        start_time = time.perf_counter()
        completed = self._run_in_process(setting, folder) if self.jobs == self.ranks == 1 else None
        if completed is None:
            code, message = run_program(
                self.scene, setting.overrides, folder, self.ranks, "--overwrite", locks=(handle,)
            )
            if self.ranks > 1 and (folder / file_layout.BLOWUP).exists():
                code = BLEW_UP  # mpirun returns another exit code
            if code not in (DONE, BLEW_UP):
                raise StudyError(f"{', '.join(setting.overrides)}: {message} ({folder})")
            completed = code == DONE
        # runs of a fit are never continued
        shutil.rmtree(folder / file_layout.CHECKPOINTS, ignore_errors=True)
        record = {
            "set": setting.overrides,
            "whole": completed,
            "seconds": round(time.perf_counter() - start_time, 3),
        }
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(folder / RECORD, json.dumps(record) + "\n")

    def _run_in_process(self, setting: Setting, folder: Path) -> bool:
        """Make a run in this process and return whether it completed."""
        try:
            overrides = (*self.scene.overrides, *setting.overrides)
            scene = load(self.scene.path, overrides, self.scene.text)
            return run(scene, folder, ranks=SerialCommunicator(), overwrite=True).code == DONE
        except BlowUp:
            return False
        except SceneError as error:
            raise StudyError(f"{', '.join(setting.overrides)}: {error.lines[0]}") from None
        except (RunFolderInUseError, StoreError) as error:
            raise StudyError(str(error)) from None


def _raise_failure(workers: list[Future]) -> None:
    """Raise the exception of a worker that has failed."""
    for worker in workers:
        if worker.done():
            worker.result()
