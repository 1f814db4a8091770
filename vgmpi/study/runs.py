"""The runs of a study, each a process of its own in a folder of its own, and what each took. A run
that is done is not done again."""

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from ..domain.launch import OPEN_MPI
from ..planning.studied import fingerprint
from ..scene.scene import Scene
from ..solver.probes import files
from .errors import Outcome
from .knobs import Setting

RECORD = "study.json"
WARM = "50 steps"  # after which nothing is compiled any more
STOPPED = 75  # exit code of a run that was stopped with a checkpoint


class StudyError(RuntimeError):
    """A run of the study did not come to its end; one line that says which, and why."""


@dataclass(frozen=True)
class Study:
    """Runs of a scene below `folder`, on so many ranks."""

    scene: Scene
    folder: Path
    ranks: int = 1

    def place(self, setting: Setting) -> Path:
        """The folder of a run."""
        return self.folder / setting.name

    def done(self, setting: Setting) -> float | None:
        """Processor time [s] of all ranks of a run from its second step on, if it is there and of
        this scene as it is now."""
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record["of"] == fingerprint(self.scene, setting.overrides):
                return float(record["cpu"])
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def run(self, setting: Setting) -> float:
        """The same, run if it is not there. Raises StudyError."""
        found = self.done(setting)
        if found is None:
            # compiles, which is not what is measured: some kernels are first called by later steps
            self._call(setting, "--overwrite", "--stop-after", WARM)
            before = self._call(setting, "--overwrite", "--stop-after", "1 steps")
            took = self._call(setting, "--resume")
            found = max(took - before, 1e-3)
            record = {"of": fingerprint(self.scene, setting.overrides), "cpu": found}
            (self.place(setting) / RECORD).write_text(json.dumps(record))
        return found

    def all(self, settings: list[Setting], needed: set[Setting]) -> dict[Setting, float]:
        """Every one of them, with a bar; those that a scene refuses, as open walls do bodies that
        coarse cells bring too near, are told and left out. Raises StudyError for those that are
        needed."""
        bar = tqdm(settings, desc="study", unit="run", disable=None)
        found = {}
        for setting in bar:
            bar.set_postfix_str(setting.name)
            try:
                found[setting] = self.run(setting)
            except StudyError as error:
                if setting in needed:
                    raise
                bar.write(f"left out: {error}", file=sys.stderr)
        return found

    def outcome(self, setting: Setting) -> Outcome:
        """What a run that is done says."""
        folder = self.place(setting)
        return Outcome(folder, files(self.scene, folder))

    def _call(self, setting: Setting, *how: str) -> float:
        """Processor time [s] of a start of the program and of its ranks."""
        folder = self.place(setting)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        code, said = started(self.scene, setting.overrides, folder, self.ranks, *how)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        # mpirun has an exit code of its own for ranks that stopped
        if code not in (0, STOPPED):
            raise StudyError(f"{setting.name}: {said} ({folder})")
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def started(
    scene: Scene, overrides: tuple[str, ...], folder: Path, ranks: int, *how: str,
    held: tuple[int, ...] = (),
) -> tuple[int, str]:  # fmt: skip
    """Exit code of the program, run on a scene with more set into a folder, and the last line that
    it said on stderr. how: flags; held: handles of locks that it holds as long as it runs."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    flags = [word for one in (*scene.overrides, *overrides) for word in ("--set", one)]
    program = [sys.executable, "-m", "vgmpi", str(scene.path), "-o", str(folder), "-q"]
    words, env = [*launcher, *program, *how, *flags], {**OPEN_MPI, **os.environ}
    made = subprocess.run(words, env=env, capture_output=True, text=True, pass_fds=held)
    lines = made.stderr.strip().splitlines() or [f"exit code {made.returncode}"]
    return made.returncode, lines[-1]
