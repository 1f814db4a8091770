"""Runs of a study, each a process in a folder of its own; finished runs are not repeated."""

import csv
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

from vgmpi.parallel.launch import OPEN_MPI
from vgmpi.planning.cost.tradeoff_results import fingerprint
from vgmpi.runtime.user_files import replace_file
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.probe_sampling import files

from .error_measures import RunOutcome
from .parameter_sweep import Setting

RECORD = "study.json"
PROFILE_TABLE = "profile.csv"  # of a run with --profile
WARM = "50 steps"  # all kernels are compiled after these
GRACE_SECONDS = 10.0  # [s] in which an interrupted program ends by itself
STOPPED = 75  # exit code of a run that stopped with a checkpoint


class StudyError(RuntimeError):
    """Error of an unfinished run: one line with its name and the reason."""


@dataclass(frozen=True)
class Study:
    """Runs of a scene below `folder`, each on `ranks` ranks."""

    scene: Scene
    folder: Path
    ranks: int = 1
    compiled: set[tuple[str, ...]] = field(default_factory=set)  # keys of compiled kernels

    def place(self, setting: Setting) -> Path:
        """Return the folder of a run."""
        return self.folder / setting.name

    def done(self, setting: Setting) -> float | None:
        """Return the processor time [s] of a finished run, from its second step on, over all ranks.

        None if there is no such run of the scene in its present form.
        """
        try:
            record = json.loads((self.place(setting) / RECORD).read_text())
            if record["of"] == fingerprint(self.scene, setting.overrides):
                return float(record["cpu"])
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def run(self, setting: Setting) -> float:
        """Return the processor time [s] of a run, which is run if it is not finished.

        Raises:
            StudyError: The run fails.
        """
        cpu_time = self.done(setting)
        if cpu_time is None:
            if (kernels := _kernel_keys(setting)) not in self.compiled:
                # outside the measurement: some kernels are first called by later steps
                self._call(setting, "--overwrite", "--stop-after", WARM)
                self.compiled.add(kernels)
            total_time = self._call(setting, "--overwrite", "--profile")
            cpu_time = max(total_time - self._startup_time(setting), 1e-3)
            record = {"of": fingerprint(self.scene, setting.overrides), "cpu": cpu_time}
            replace_file(self.place(setting) / RECORD, json.dumps(record))
        return cpu_time

    def all(
        self,
        settings: list[Setting],
        needed: set[Setting],
        report: Callable[[dict[Setting, float]], list[str]] = lambda _: [],
    ) -> dict[Setting, float]:
        """Return the processor time [s] of all settings, with a progress bar.

        Runs that fail, such as bodies too near to open walls in coarse cells, are reported and
        skipped.

        Args:
            settings: Settings to run.
            needed: Settings without which there is no result.
            report: Function that returns the lines to print after a run, given the processor times
            [s] so far. It is not called for runs of an earlier call, nor for the last one.

        Raises:
            StudyError: A needed run fails.
        """
        bar = tqdm(settings, desc="study", unit="run", disable=None)
        cpu_times: dict[Setting, float] = {}
        for setting in bar:
            bar.set_postfix_str(setting.name)
            is_old = self.done(setting) is not None
            try:
                cpu_times[setting] = self.run(setting)
                if bar.disable:  # no terminal: a line per run
                    line = f"run {len(cpu_times)} of {len(settings)}: {setting.name}"
                    spent = f"{cpu_times[setting]:.3g} s of processor time"
                    bar.write(f"{line}: {spent}", file=sys.stderr)
            except StudyError as error:
                if setting in needed:
                    raise
                bar.write(f"left out: {error}", file=sys.stderr)
                continue
            if not is_old and setting != settings[-1] and (lines := report(cpu_times)):
                bar.write("\n".join(lines), file=sys.stderr)
        return cpu_times

    def _startup_time(self, setting: Setting) -> float:
        """Return the processor time [s] of all ranks up to the end of their first step."""
        with open(self.place(setting) / PROFILE_TABLE, newline="") as file:
            return sum(float(row["startup_cpu"]) for row in csv.DictReader(file))

    def outcome(self, setting: Setting) -> RunOutcome:
        """Return the results of a finished run."""
        folder = self.place(setting)
        return RunOutcome(folder, files(self.scene, folder))

    def _call(self, setting: Setting, *flags: str) -> float:
        """Run the program with its ranks and return their processor time [s]."""
        folder = self.place(setting)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        code, message = run_program(self.scene, setting.overrides, folder, self.ranks, *flags)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        # mpirun has an exit code of its own for ranks that stopped
        if code not in (0, STOPPED):
            raise StudyError(f"{setting.name}: {message} ({folder})")
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _kernel_keys(setting: Setting) -> tuple[str, ...]:
    """Return the overrides of a setting that select other kernels."""
    numbers = ("domain.cell=", "time.cfl=", "time.dt=")
    return tuple(text for text in setting.overrides if not text.startswith(numbers))


def run_program(
    scene: Scene, overrides: tuple[str, ...], folder: Path, ranks: int, *extra_flags: str,
    locks: tuple[int, ...] = (),
) -> tuple[int, str]:  # fmt: skip
    """Run the program on a scene with overrides.

    Args:
        scene: The scene.
        overrides: Further overrides for --set.
        folder: Output folder.
        ranks: MPI ranks.
        extra_flags: Further flags.
        locks: Handles of locks that the program holds while it runs.

    Returns:
        Exit code, and the last line on stderr.
    """
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    flags = [word for override in (*scene.overrides, *overrides) for word in ("--set", override)]
    program = [sys.executable, "-m", "vgmpi", str(scene.path), "-o", str(folder), "-q"]
    program += ["--ranks", str(ranks)]
    words, env = [*launcher, *program, *extra_flags, *flags], {**OPEN_MPI, **os.environ}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        words, env=env, stdout=pipe, stderr=pipe, text=True, pass_fds=locks
    ) as process:
        try:
            _, errors = process.communicate()
        except BaseException:
            _end_program(process)
            raise
    lines = errors.strip().splitlines() or [f"exit code {process.returncode}"]
    return process.returncode, lines[-1]


def _end_program(process: subprocess.Popen) -> None:
    """Wait until an interrupted program has ended, so that none of its ranks outlives the study.

    A terminal interrupts the program as well. A program that was not interrupted, or does not
    end, is terminated, and killed at last.
    """
    for stop in (process.terminate, process.kill):
        try:
            process.communicate(timeout=GRACE_SECONDS)
            return
        except subprocess.TimeoutExpired:
            stop()
    process.communicate()
