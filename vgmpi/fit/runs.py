"""Runs of a scene by their parameters, each in a folder of its own; one that is done is not done
again, so that a fit that was stopped goes on as if it had not been. Several processes may make
them at once, each those that no other has begun."""

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

from ..api import run
from ..domain.ranks import Alone
from ..output import layout
from ..output.owner import FolderError, claimed
from ..output.store import StoreError, replace_text
from ..planning.studied import fingerprint
from ..scene.reader import load
from ..scene.scene import Scene
from ..solver.run import BLEW_UP, DONE
from ..solver.step import BlowUp
from ..study.knobs import Setting
from ..study.runs import StudyError, started
from ..tables import SceneError

RECORD = "fit.json"
WAIT = 0.1  # seconds between looks at runs that others make


@dataclass(frozen=True)
class Done:
    """A run: its folder, the seconds it took, and whether it came to its end: one that blew up did
    not."""

    folder: Path
    seconds: float
    whole: bool


class Runs:
    """Runs of a scene below `folder`: so many side by side (`jobs`), on so many ranks each. With
    one of both they are made in this process, which saves the start of another."""

    def __init__(self, scene: Scene, folder: Path, ranks: int = 1, jobs: int = 1):
        self.scene, self.folder, self.ranks, self.jobs = scene, folder, ranks, jobs

    def place(self, setting: Setting) -> Path:
        """The folder of a run."""
        return self.folder / fingerprint(self.scene, (*setting.overrides, *self._contents))

    @functools.cached_property
    def _contents(self) -> tuple[str, ...]:
        """What is in the files that the scene names, meshes and captures: a run of others is
        another one. Raises StudyError."""
        found = []
        for name, path in sorted(self.scene.files.items()):
            try:
                with open(path, "rb") as file:
                    found.append(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}")
            except OSError as error:
                raise StudyError(f"{path}: {error.strerror or error}") from None
        return tuple(found)

    def done(self, setting: Setting) -> Done | None:
        """A run that is there, whole, of this scene as it is now."""
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record["set"] == list(setting.overrides):
                return Done(self.place(setting), float(record["seconds"]), bool(record["whole"]))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def all(self, settings: list[Setting]) -> Iterator[Done]:
        """Each of them in this order, as soon as it is there: made here, or by another process
        that does the same at the same time. Raises StudyError where one cannot be run."""
        over = threading.Event()
        left = [one for one in dict.fromkeys(settings) if self.done(one) is None]
        if self.jobs == 1:
            for one in settings:
                while (found := self.done(one)) is None:
                    self._next(left)
                yield found
            return
        with ThreadPoolExecutor(self.jobs) as pool:
            workers = [pool.submit(self._work, left, over) for _ in range(self.jobs)]
            try:
                for one in settings:
                    while (found := self.done(one)) is None:
                        _raised(workers)
                        time.sleep(WAIT)
                    yield found
            finally:
                over.set()

    def _work(self, left: list[Setting], over: threading.Event) -> None:
        """One of several side by side: until there is nothing left, or it is over."""
        while not over.is_set() and any(self.done(one) is None for one in left):
            self._next(left)

    def _next(self, left: list[Setting]) -> None:
        """Make the first run that is neither there nor begun; wait a little where all are. A run
        whose process died is not begun: the system drops the lock of what it kills."""
        for one in left:
            if self.done(one) is None and self._claim(one):
                return
        time.sleep(WAIT)

    def _claim(self, setting: Setting) -> bool:
        """Make a run, unless another process does; whether it did not."""
        folder = self.place(setting)
        try:
            with claimed(folder.with_name(f"{folder.name}.lock")) as handle:
                if handle is None:
                    return False
                os.listdir(folder.parent)  # NFS: what others wrote is looked up anew
                if self.done(setting) is None:  # another may have ended it meanwhile
                    self._make(setting, handle)
                return True
        except OSError as error:
            raise StudyError(f"{folder}: {error.strerror or error}") from None

    def _make(self, setting: Setting, handle: int) -> None:
        folder = self.place(setting)
        (folder / RECORD).unlink(missing_ok=True)
        began = time.perf_counter()
        whole = self._here(setting, folder) if self.jobs == self.ranks == 1 else None
        if whole is None:
            code, said = started(
                self.scene, setting.overrides, folder, self.ranks, "--overwrite", held=(handle,)
            )
            if self.ranks > 1 and (folder / layout.BLOWUP).exists():
                code = BLEW_UP  # mpirun has an exit code of its own
            if code not in (DONE, BLEW_UP):
                raise StudyError(f"{', '.join(setting.overrides)}: {said} ({folder})")
            whole = code == DONE
        shutil.rmtree(folder / layout.CHECKPOINTS, ignore_errors=True)  # nobody goes on from it
        record = {
            "set": setting.overrides,
            "whole": whole,
            "seconds": round(time.perf_counter() - began, 3),
        }
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(folder / RECORD, json.dumps(record) + "\n")

    def _here(self, setting: Setting, folder: Path) -> bool:
        """The run in this process: whether it came to its end."""
        try:
            overrides = (*self.scene.overrides, *setting.overrides)
            scene = load(self.scene.path, overrides, self.scene.text)
            return run(scene, folder, ranks=Alone(), overwrite=True).code == DONE
        except BlowUp:
            return False
        except SceneError as error:
            raise StudyError(f"{', '.join(setting.overrides)}: {error.lines[0]}") from None
        except (FolderError, StoreError) as error:
            raise StudyError(str(error)) from None


def _raised(workers: list[Future]) -> None:
    """Raises what one of them has raised."""
    for one in workers:
        if one.done():
            one.result()
