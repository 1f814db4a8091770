"""Contestants in processes of their own, timed in turns: A B C A B C ...

A change of the machine's pace then meets all of them, and ratios are taken between neighbors in
time.
"""

import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from vgmpi.parallel.launch import OPEN_MPI

from .benchmark_case import DX, PER_STEP, BenchError, Case, WorkerError
from .contestant_worker import CONTESTANTS

START_SECONDS = 300.0  # a contestant may take to compile
MAX_CYCLES = 20  # in a slice of ours: the cube must not reach the walls
SLICE_SECONDS = 0.1  # wall time of a slice of a round
LEAST_SLICES = 3  # of a round
WORKER_NUMBERS = itertools.count()
RIVAL_LAWS = ("fluid", "elastic")  # written in the rivals, too
NAMES = {
    "own": "vgmpi",
    "plain": "numba loops",
    "taichi_rival": "Taichi",
    "warp_rival": "Warp",
}
WORKER = "vgmpi.tools.bench.contestant_worker"  # module of a contestant's process
AVX2 = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2"}
# what two contestants may differ by after the check's steps: rounding of single precision, for the
# rivals of positions counted from the grid's corner
POSITION_TOLERANCE = 1e-4  # [cells]
VELOCITY_TOLERANCE = 2e-5  # of the cube's speed
CONSERVATION_TOLERANCE = 1e-5  # of total mass and momentum


@dataclass(frozen=True)
class Contestant:
    """Program with its options that takes part in the measurement."""

    module: str
    precision: str = "single"
    ranks: int = 1
    threads: int = 1
    cpu: str = ""  # "": what the machine has
    tree: str = ""  # another checkout of this program; "": this one
    card: bool = False  # on a graphics card
    more: tuple[tuple[str, str], ...] = ()  # of its environment

    @property
    def name(self) -> str:
        """Return the name of the program."""
        return NAMES[self.module]

    @property
    def path(self) -> str:
        """The module that makes it, which other checkouts know better than this one."""
        return "" if self.tree else CONTESTANTS[self.module]

    @property
    def on(self) -> str:
        """Return the hardware, for people."""
        if self.card:
            return "card"
        if self.ranks > 1:
            return f"{self.ranks} ranks"
        return f"{self.threads} threads" if self.threads > 1 else "1 core"

    @property
    def label(self) -> str:
        """Return the label of the row."""
        origin = f"of {Path(self.tree).name}" if self.tree else ""
        return " ".join(w for w in (self.name, self.precision, self.on, self.cpu, origin) if w)

    @property
    def clock(self) -> str:
        """Return the clock that counts: wall or processor time."""
        return "wall" if self.card or self.ranks * self.threads > 1 else "cpu"

    def obstacle(self) -> str:
        """Why it cannot start here, or ""."""
        if self.ranks > 1 and shutil.which("mpirun") is None:
            return "no mpirun found"
        return ""


def worker_of(tree: Path) -> str:
    """The module of a checkout that a contestant's process runs. Raises BenchError."""
    if (tree / f"{WORKER.replace('.', '/')}.py").is_file():
        return WORKER
    raise BenchError(f"{tree}: no checkout of this program: it has no {WORKER}")


class Worker:
    """A contestant's process or ranks. Raises BenchError where it cannot start or ends early."""

    def __init__(self, contestant: Contestant, case: Case, folder: Path):
        self.contestant = contestant
        name = f"worker_{next(WORKER_NUMBERS)}"
        self.log = folder / f"{name}.log"
        address = str(folder / name)
        config = {
            "module": contestant.module,
            "path": contestant.path,
            "socket": address,
            "ranks": contestant.ranks,
            "threads": contestant.threads,
            "folder": str(folder / contestant.precision),
            "particles": str(folder / "dense.npz"),
            "numbers": case.numbers(),
        }
        package = contestant.tree or str(Path(__file__).parents[3])
        command = [sys.executable, "-m", worker_of(Path(package)), json.dumps(config)]
        if contestant.ranks > 1:
            command = ["mpirun", "-n", str(contestant.ranks), *command]
        env = {**OPEN_MPI, **os.environ, "PYTHONPATH": package}
        env |= AVX2 if contestant.cpu == "avx2" else {}
        env |= {"VGMPI_BENCH_DEVICE": "cuda"} if contestant.card else {}
        env |= dict(contestant.more)
        listener = socket.socket(socket.AF_UNIX)
        try:
            listener.bind(address)
        except OSError as error:
            raise BenchError(f"{address}: {error}; set TMPDIR to a shorter path") from None
        listener.listen()
        self.links: list[tuple[socket.socket, IO[str]]] = []
        with open(self.log, "w") as out:
            self.process = subprocess.Popen(
                command,
                env=env,
                cwd=package,  # python -m looks here first
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        try:
            self._meet(listener)
            self.versions = self._hear()[0]["versions"]
        except BaseException:
            self.close()
            raise
        finally:
            listener.close()
            os.unlink(address)

    def _meet(self, listener: socket.socket) -> None:
        listener.settimeout(0.2)
        until = time.monotonic() + START_SECONDS
        while len(self.links) < self.contestant.ranks:
            try:
                link, _ = listener.accept()
            except TimeoutError:
                if self.process.poll() is not None or time.monotonic() > until:
                    raise WorkerError(self._last_words()) from None
                continue
            link.settimeout(START_SECONDS)
            self.links.append((link, link.makefile("rw", encoding="utf-8")))

    def _hear(self) -> list[dict]:
        answers = []
        for _, lines in self.links:
            try:
                line = lines.readline()
            except TimeoutError:
                raise WorkerError(f"no answer in {START_SECONDS:.0f} s") from None
            if not line:
                raise WorkerError(self._last_words())
            answers.append(json.loads(line))
            if answers[-1].get("missing") in ("taichi", "warp"):
                raise BenchError("not installed: pip install 'vgmpi[bench]'")
            if "error" in answers[-1]:
                raise WorkerError(answers[-1]["error"])
        return answers

    def ask(self, do: str, **what) -> dict:
        """Return one answer for all ranks.

        A round takes as long as its slowest rank, a stage as long as the mean; masses are added.
        """
        try:
            for _, lines in self.links:
                lines.write(json.dumps({"do": do, **what}) + "\n")
                lines.flush()
        except OSError:
            raise WorkerError(self._last_words()) from None
        answers = self._hear()
        answer_of_all = dict(answers[0])
        for key, join in (("seconds", max), ("wall", max), ("mass", sum)):
            if key in answer_of_all:
                answer_of_all[key] = join(answer[key] for answer in answers)
        if "stages" in answer_of_all:
            spent = [answer["stages"] for answer in answers]
            answer_of_all["stages"] = {
                s: sum(times[s] for times in spent) / len(spent) for s in spent[0]
            }
        return answer_of_all

    def _last_words(self) -> str:
        messages = [line for line in self.log.read_text().splitlines() if line.strip()]
        return "ended early: " + (messages[-1] if messages else "it said nothing")

    def close(self) -> None:
        """Workers end when their socket closes; what does not is stopped."""
        for link, lines in self.links:
            lines.close()
            link.close()
        for number in (signal.SIGTERM, signal.SIGKILL):  # mpirun hands the first on to its ranks
            try:
                self.process.wait(10)
                return
            except subprocess.TimeoutExpired:
                os.killpg(self.process.pid, number)
        self.process.wait()


def run_interleaved(
    case: Case, contestants: list[Contestant], rounds: int, seconds: float, folder: Path, say
) -> list[dict]:
    """Measure contestants in turns; return a row for each, the first is the reference.

    Args:
        case: Law and particles.
        contestants: Contestants.
        rounds: Number of rounds.
        seconds: Approximate length of a round [s].
        folder: Folder of the laid out case.
        say: Called with a progress line.
    """
    rows = [{**vars(c), "name": c.name, "on": c.on, "clock": c.clock} for c in contestants]
    live: list[tuple[dict, Worker]] = []
    try:
        workers = _start_workers(case, contestants, folder, say)
        for row, worker in zip(rows, workers, strict=True):
            if isinstance(worker, Worker):
                live.append((row, worker))
                row["versions"] = worker.versions
            else:
                _note_failure(row, worker)
        say(f"{case.law}, {case.particles:,} particles: checking that all compute the same")
        _check(case, live, folder)
        _turns(case, live, rounds, seconds, say)
    finally:
        for _, worker in live:
            worker.close()
    return rows


def _start_workers(
    case: Case, contestants: list[Contestant], folder: Path, say
) -> list[Worker | BenchError]:
    """Return the workers, or why one cannot start; those of a card start at the same time."""

    def start(contestant: Contestant) -> Worker | BenchError:
        """Return the worker of a contestant, or why it cannot start."""
        say(f"{case.law}, {case.particles:,} particles: starting {contestant.label}")
        try:
            if contestant.obstacle():
                raise BenchError(contestant.obstacle())
            return Worker(contestant, case, folder)
        except BenchError as error:
            return error

    at_once = len(contestants) if all(c.card for c in contestants) else 1
    with ThreadPoolExecutor(at_once) as pool:
        return list(pool.map(start, contestants))


def _turns(case: Case, live: list, rounds: int, seconds: float, say) -> None:
    """Measure all contestants in turns.

    A round has slices of about SLICE_SECONDS (steps, or whole cycles), and its fastest one counts:
    whatever else a machine does only makes a slice longer, for parts of a second to seconds.
    """
    units, slices = {}, {}

    def trial(row, worker):
        """Choose units and number of slices from one trial."""
        wall = max(worker.ask("round", units=1)["wall"], 1e-6)
        n = max(1, round(SLICE_SECONDS / wall))
        units[worker] = min(n, MAX_CYCLES) if row["module"] == "own" else n
        slices[worker] = max(LEAST_SLICES, round(seconds / (wall * units[worker])))
        row["rounds"] = []

    def measure_round(row, worker):
        """Append the fastest slice of a round."""
        answers = [worker.ask("round", units=units[worker]) for _ in range(slices[worker])]
        row["rounds"].append(min(answers, key=lambda answer: answer["seconds"] / answer["steps"]))

    _each(live, trial)
    for k in range(rounds):
        say(f"{case.law}, {case.particles:,} particles: round {k + 1} of {rounds}")
        _each(live, measure_round)


def _each(live: list, action) -> None:
    """action(row, worker) for all; one that fails says so in its row and takes no further part."""
    for row, worker in list(live):
        try:
            action(row, worker)
        except BenchError as error:
            _note_failure(row, error)
            row.pop("rounds", None)
            worker.close()
            live.remove((row, worker))


def _note_failure(row: dict, error: BenchError) -> None:
    """Note in a row why there is no result, and whether its program failed."""
    row["note"] = str(error)
    if isinstance(error, WorkerError):
        row["failed"] = True


def _check(case: Case, live: list, folder: Path) -> None:
    """Let all compute the same steps from the start; a row whose result is off says so in `wrong`.

    Compares positions and velocities with the first contestant's, and each one's total mass and
    momentum with what they must be.
    """
    steps = 30 if case.particles <= 200_000 else 8  # the rivals are slow; 20 hold a sort of ours
    mass = case.material.bulk_density * DX**3 / 8 * case.particles
    with np.load(folder / "dense.npz") as start:
        begun = start["v"].mean(0)
    falling = begun + np.array([0.0, 0.0, case.numbers()["gravity"] * steps * case.dt])
    speed = PER_STEP * DX / case.dt
    first: list[np.ndarray] = []

    def compare(row, worker):
        """Compute the check steps and compare the result."""
        path = folder / f"check_{worker.contestant.label.replace(' ', '_')}"
        answer = worker.ask("check", steps=steps, path=str(path))
        x, v = _gathered(path)
        first.extend([] if first else [x, v])
        row["checked"] = {
            "steps": steps,
            "far": float(np.abs(x - first[0]).max() / DX),
            "fast": float(np.abs(v - first[1]).max() / speed),
            "mass": abs(answer["mass"] / mass - 1.0),
            "momentum": float(np.abs(v.mean(0, dtype=np.float64) - falling).max() / speed),
        }
        bounds = {
            "far": POSITION_TOLERANCE,
            "fast": VELOCITY_TOLERANCE,
            "mass": CONSERVATION_TOLERANCE,
            "momentum": CONSERVATION_TOLERANCE,
        }
        deviations = [f"{k} {row['checked'][k]:.1e}" for k, bound in bounds.items()
               if not row["checked"][k] <= bound]  # fmt: skip
        if deviations:
            row["wrong"] = "computes something else: " + ", ".join(deviations)

    _each(live, compare)


def _gathered(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of all ranks' files by id, which are removed."""
    parts = []
    for file in sorted(path.parent.glob(f"{path.name}*.npz")):
        with np.load(file) as arrays:
            parts.append([arrays[name] for name in ("id", "x", "v")])
        file.unlink()
    ids, x, v = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(ids)
    return x[order].astype(np.float64), v[order].astype(np.float64)
