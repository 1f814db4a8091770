"""The runs of a study, each a process of its own in a folder of its own, and what each took. A run
that is done is not done again."""

import hashlib
import json
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from tqdm import tqdm

from .errors import Outcome
from .knobs import Setting

RECORD = "study.json"
STOPPED = 75  # exit code of a run that was stopped with a checkpoint


class StudyError(RuntimeError):
    """A run of the study did not come to its end; one line that says which, and why."""


@dataclass(frozen=True)
class Took:
    """cpu: processor time of all ranks [s], from the second step on. wall: by the clock [s]."""

    cpu: float
    wall: float


@dataclass(frozen=True)
class Study:
    """Runs of a scene below `folder`, on so many ranks."""

    scene: Path
    folder: Path
    ranks: int = 1

    def place(self, setting: Setting) -> Path:
        """The folder of a run."""
        return self.folder / setting.name

    def done(self, setting: Setting) -> Took | None:
        """What a run took, if it is there and of this scene as it is now."""
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record.pop("of") == self._of(setting):
                return Took(**record)
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def run(self, setting: Setting) -> Took:
        """The same, run if it is not there. Raises StudyError."""
        found = self.done(setting)
        if found is None:
            # compiles, which is not what is measured
            self._call(setting, "--overwrite", "--stop-after", "1 steps")
            before = self._call(setting, "--resume", "--stop-after", "1 steps")
            took = self._call(setting, "--resume")
            found = Took(max(took.cpu - before.cpu, 1e-3), took.wall)
            record = {"of": self._of(setting), **asdict(found)}
            (self.place(setting) / RECORD).write_text(json.dumps(record))
        return found

    def all(self, settings: list[Setting]) -> dict[Setting, Took]:
        """Every one of them, with a bar."""
        bar = tqdm(settings, desc="study", unit="run", disable=None)
        found = {}
        for setting in bar:
            bar.set_postfix_str(setting.name)
            found[setting] = self.run(setting)
        return found

    def outcome(self, setting: Setting) -> Outcome:
        """What a run that is done says."""
        return Outcome(self.place(setting))

    def _of(self, setting: Setting) -> str:
        text = self.scene.read_bytes() + repr(setting.overrides).encode()
        return hashlib.sha256(text).hexdigest()[:16]

    def _call(self, setting: Setting, *how: str) -> Took:
        folder = self.place(setting)
        launcher = ["mpirun", "-n", str(self.ranks)] if self.ranks > 1 else []
        flags = [word for one in setting.overrides for word in ("--set", one)]
        program = [sys.executable, "-m", "vgmpi", str(self.scene), "-o", str(folder), "-q"]
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        made = subprocess.run([*launcher, *program, *how, *flags], capture_output=True, text=True)
        wall = time.perf_counter() - begin
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        # mpirun has an exit code of its own for ranks that stopped
        if made.returncode not in (0, STOPPED):
            lines = made.stderr.strip().splitlines() or [f"exit code {made.returncode}"]
            raise StudyError(f"{setting.name}: {lines[-1]} ({folder})")
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return Took(spent, wall)
