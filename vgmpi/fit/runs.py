"""Runs of a scene by their parameters, each in a folder of its own; one that is done is not done
again, so that a fit that was stopped goes on as if it had not been."""

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..api import run
from ..domain.ranks import Alone
from ..output import layout
from ..output.owner import FolderError
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
        return self.folder / fingerprint(self.scene, setting.overrides)

    def done(self, setting: Setting) -> Done | None:
        """A run that is there, whole, of this scene as it is now."""
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record["set"] == list(setting.overrides):
                return Done(self.place(setting), float(record["seconds"]), bool(record["whole"]))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def all(self, settings: list[Setting]) -> list[Done]:
        """Each of them, made if it is not there. Raises StudyError where one cannot be run."""
        left = [one for one in dict.fromkeys(settings) if self.done(one) is None]
        if self.jobs > 1:
            with ThreadPoolExecutor(self.jobs) as pool:
                list(pool.map(self._make, left))
        else:
            for one in left:
                self._make(one)
        found = [self.done(one) for one in settings]
        return [one for one in found if one is not None]

    def _make(self, setting: Setting) -> None:
        folder = self.place(setting)
        (folder / RECORD).unlink(missing_ok=True)
        began = time.perf_counter()
        whole = self._here(setting, folder) if self.jobs == self.ranks == 1 else None
        if whole is None:
            code, said = started(self.scene, setting.overrides, folder, self.ranks, "--overwrite")
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
