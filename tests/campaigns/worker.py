"""Many commands in one process: what each said, its processor time, and the peak of its memory.

Commands are called as from a shell, by what `python -m` calls, in a process that stays: starting
one for each would take most of the time. A case that takes too long is ended by the kernel, with
the processor time as its clock, and named.
"""

import contextlib
import faulthandler
import importlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.campaigns.result import Result
from tests.support import peak_memory
from tests.support.cost_counter import CostCounter
from vgmpi.planning.cost.run_estimate import PILOT_SECONDS

ROOT = Path(__file__).parents[2]
SECONDS = (
    10  # of processor time that a command may take, but for compiling and the pilot run of a plan
)
EACH = 1e-4  # and for each particle that it makes of a mesh or a capture, and says so
MOST_SECONDS = 60  # in any case
WAITING = 1200  # seconds by the wall clock: what waits for something that never comes
MEGABYTES = 1000  # that the process may hold at a time, all that is imported included
LONGEST = 3000  # characters of a line
FREE = 128 << 20  # bytes that `available_memory` returns: larger cases are refused on any machine
MODULES = {
    "vgmpi": ("vgmpi.__main__", "main"),
    "render": ("vgmpi.postprocess.commands.render", "command"),
    "photo": ("vgmpi.tools.photo.__main__", "main"),
    "convert": ("vgmpi.tools.convert.__main__", "main"),
}
_ADDRESSES = 16 << 30  # bytes: so that a fault does not take the machine with it
_CASES = 200  # of a process: what the ones before left behind is not counted for long
_MADE = re.compile(r"(\d+) particles on its surface, (\d+) inside")
_FAULT = re.compile(r"(Warning: |Traceback|please report it|object \{|Fatal Python error)")


class Said(NamedTuple):
    """Of one command: exit code (negative: of the signal that ended it), what it said on stderr,
    seconds of processor time, and the peak memory [MB]."""

    code: int
    err: str
    seconds: float
    peak: float
    allowed: float  # seconds that it may take

    def fault(self) -> str:
        """What no command may do whatever it is given; "" if it did none of that."""
        if self.code == -signal.SIGPROF:
            return f"more than {MOST_SECONDS} s of processor time: {self._where()}"
        if self.code == -signal.SIGALRM:
            return f"nothing for {WAITING} s"
        if self.code not in (0, 2):
            return f"exit code {self.code}: {self._last()}"
        if found := _FAULT.search(self.err):
            at = self.err.rfind("\n", 0, found.start()) + 1
            return self.err[at:].splitlines()[0]
        made = sum(int(n) for pair in _MADE.findall(self.err) for n in pair)
        if self.seconds > self.allowed + EACH * made:
            return f"{self.seconds:.1f} s of processor time, {made:,} particles made"
        if self.peak > MEGABYTES:
            return f"{self.peak:.0f} MB"
        return ""

    def lines(self) -> list[str]:
        """What was said, but for what the program notes and goes on."""
        return [line for line in self.err.splitlines() if not line.startswith("vgmpi: ")]

    def _last(self) -> str:
        return (self.err.strip().splitlines() or [""])[-1]

    def _where(self) -> str:
        ours = [line for line in self.err.splitlines() if "/vgmpi/" in line or "/postproc" in line]
        return ours[0].strip() if ours else self._last()


Case = list[list[str]]  # commands, one after the other as long as they end with 0


def said(cases: list[Case], warm: Case) -> Iterator[list[Said]]:
    """What the commands of each case said, up to the first that did not end with 0. warm: commands
    that bring in all that the others need, which is not counted."""
    process = None
    for k, case in enumerate(cases):
        if k % _CASES == 0 and process:
            _ended(process)
            process = None
        if process is None:
            process = _Process()
            if bad := next((s for s in process.run(warm, limited=False) if s.code), None):
                raise RuntimeError(f"what all cases are made of is wrong: {bad.err[-2000:]}")
        found = process.run(case)
        if found and found[-1].code < 0:
            process = None
        yield found
    if process:
        _ended(process)


def _ended(process: "_Process") -> None:
    process.child.stdin.close()
    process.child.wait()
    process.errors.close()


class _Process:
    """A process of its own that runs commands."""

    def __init__(self) -> None:
        self.errors = tempfile.TemporaryFile("w+", errors="replace")
        quiet = [f"-Wignore::{name}Warning" for name in ("Deprecation", "PendingDeprecation")]
        quiet += [f"-Wignore::{name}Warning" for name in ("Resource", "Import")]
        command = [sys.executable, "-Walways", *quiet, "-m", __spec__.name]
        self.child = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            text=True, env={**os.environ, "PYTHONPATH": str(ROOT), "VGMPI_JOBS": "1"},
        )  # fmt: skip

    def run(self, case: Case, limited: bool = True) -> list[Said]:
        """limited: in the time it may take, which does not hold for what is compiled before."""
        found = []
        for command in case:
            found.append(self._one(command, limited))
            if found[-1].code:
                break
        return found

    def _one(self, command: list[str], limited: bool) -> Said:
        self.errors.seek(0)
        self.errors.truncate()
        with contextlib.suppress(BrokenPipeError):
            self.child.stdin.write(json.dumps([limited, *command]) + "\n")
            self.child.stdin.flush()
        line = self.child.stdout.readline()
        code, seconds, peak = json.loads(line) if line else (self.child.wait(), 0.0, 0.0)
        self.errors.seek(0)
        allowed = SECONDS + PILOT_SECONDS * ("--plan" in command)
        return Said(code, self.errors.read(), seconds, peak, allowed)


def _serve() -> None:
    """Run the commands that come on stdin."""
    from vgmpi.runtime import process_limits

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.enable()
    faulthandler.register(signal.SIGPROF, chain=True)  # says where, then ends as without it
    process_limits.available_memory = lambda swap=False: FREE
    costs = CostCounter(time.process_time)
    for line in sys.stdin:
        limited, program, *words = json.loads(line)
        sys.argv = [program, *words]
        os.lseek(2, 0, os.SEEK_SET)
        peak_memory.forget()
        begin, (compiled, _) = time.process_time(), costs()
        signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS if limited else 0)
        signal.alarm(WAITING)
        try:
            code = _program(program)()
        except SystemExit as left:  # of argparse
            code = left.code
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        seconds = time.process_time() - begin - (costs()[0] - compiled)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        answers.write(json.dumps([code, seconds, peak_memory.megabytes()]) + "\n")
        answers.flush()


def _program(name: str) -> Callable[[], int]:
    """What `python -m` calls."""
    return importlib.import_module(MODULES[name][0]).__dict__[MODULES[name][1]]


def unclear(said: Said, where: re.Pattern) -> str:
    """The first line of a refusal that does not say what is wrong where; "" where all do. where:
    how such lines begin."""
    if said.code == 0:
        return ""
    lines = said.lines() or said.err.splitlines()
    if not lines:
        return "refused without a word"
    for line in said.err.split("\n")[:-1]:
        if not line.isprintable() or len(line) > LONGEST:
            return f"not a line for people: {ascii(line[:200])}"
    if wrong := [line for line in lines if not where.match(line)]:
        return f"unclear: {wrong[0]}"
    return f"said twice: {lines[0]}" if len(set(lines)) < len(lines) else ""


def judged(
    files: list[Path],
    cases: list[Case],
    warm: Case,
    where: Callable[[Path, list[str]], re.Pattern],
    named: Callable[[Path, list[str], int], str],
) -> Result:
    """Try the cases, of a file each, and say what came out. Files of those that fail stay.

    where: how lines of a refusal begin, of a file and the command that refused it. named: the name
    of an outcome, of the same and the exit code.
    """
    counts: Counter[str] = Counter()
    failures = []
    for path, case, found in zip(files, cases, said(cases, warm), strict=True):
        last, command = found[-1], case[len(found) - 1]
        bad = next(filter(None, (each.fault() for each in found)), "")
        bad = bad or unclear(last, where(path, command))
        counts["failed" if bad else named(path, command, last.code)] += 1
        if bad:
            failures.append(_kept(path, bad, case[: len(found)], last))
        else:
            path.unlink()
    return Result(len(files), dict(counts), failures)


def _kept(path: Path, why: str, case: Case, said: Said) -> str:
    """The line of a case that failed, with what was said in a file beside its own."""
    shown = "; ".join(" ".join(words) for words in case)
    path.with_suffix(".txt").write_text(f"{why}\n{shown}\n{said.err[-20000:]}")
    return f"{path}: {why[:300]}: {shown[:1000]}"


if __name__ == "__main__":
    _serve()
