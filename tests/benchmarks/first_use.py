"""What a new user waits for: whole commands with the README's first scene, by the clock.

Install, run and preview start from an empty home folder; run and video follow with the compiled
code there. Each checkout takes its turn, and each command waits until other programs leave the
cores.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

from tests.benchmarks.core_use import scene_file, wait_for_cores
from tests.support.launch import ROOT
from vgmpi.tools.bench.benchmark_case import BenchError

COMMANDS = {  # words after `python -m vgmpi`; SCENE and OUT are paths
    "run, cold": ["SCENE", "-o", "OUT"],
    "preview, cold": ["render", "OUT", "--preview"],
    "run": ["SCENE", "-o", "OUT-again"],
    "video": ["render", "OUT", "-o", "OUT/video.mp4"],
}
INSTALL = "install"


def time_command(words: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Return wall time and processor time [s] of a command with all its children.

    Args:
        words: The command.
        environment: Its environment variables.

    Raises:
        BenchError: If the command fails.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.monotonic()
    home = environment["HOME"]  # not the folder of a checkout: Python would take that one
    done = subprocess.run(words, cwd=home, env=environment, capture_output=True, text=True)
    wall = time.monotonic() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise BenchError(f"{' '.join(words)} failed:\n{done.stdout[-500:]}{done.stderr[-2000:]}")
    spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return wall, spent


def measure_first_use(
    tree: Path, install: bool, patience: float, say: Callable
) -> dict[str, tuple[float, float, float]]:
    """Return wall time [s], processor time [s] and cores free before, of each command in its order.

    Args:
        tree: Folder of a checkout.
        install: Whether it is also installed into a new environment.
        patience: Longest wait for free cores before each command [s].
        say: Function that prints progress.
    """
    taken = {}
    with tempfile.TemporaryDirectory(prefix="vgmpi-first-") as name:
        folder = Path(name)
        environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        environment |= {"HOME": name, "XDG_CACHE_HOME": f"{name}/.cache", "PYTHONPATH": str(tree)}
        scene, python = scene_file("ball", folder), sys.executable
        jobs = {}
        if install:
            subprocess.run([sys.executable, "-m", "venv", f"{name}/venv"], check=True)
            python = f"{name}/venv/bin/python"
            jobs[INSTALL] = [python, "-m", "pip", "install", "-q", "--no-cache-dir", str(tree)]
            environment.pop("PYTHONPATH")
        for what, words in COMMANDS.items():
            paths = [w.replace("SCENE", str(scene)).replace("OUT", f"{name}/out") for w in words]
            jobs[what] = [python, "-m", "vgmpi", *paths]
        for what, job in jobs.items():
            free = wait_for_cores((os.cpu_count() or 1) - 0.2, patience)
            taken[what] = *time_command(job, environment), free
            say(f"{tree.name}: {what} {taken[what][0]:.1f} s, {free:.1f} cores free")
    return taken


def compare_first_use(
    tree: Path | None, install: bool, rounds: int, patience: float, say: Callable
) -> Iterator[str]:
    """Yield lines of a table: medians of each command, of this checkout and of another in turns.

    Args:
        tree: Folder of the other checkout, or None.
        install: Whether both are also installed into new environments.
        rounds: Number of rounds.
        patience: Longest wait for free cores before each command [s].
        say: Function that prints progress.
    """
    trees = [ROOT, *([tree.resolve()] if tree else [])]
    seen: dict[Path, list] = {each: [] for each in trees}
    for _ in range(rounds):
        for each in trees:
            seen[each].append(measure_first_use(each, install, patience, say))
    yield "| command | " + " | ".join(f"{each.name}: wall, processor [s]" for each in trees) + " |"
    yield "|---" * (1 + len(trees)) + "|"
    for what in seen[ROOT][0]:
        cells = []
        for each in trees:
            wall, spent, _ = (median(column) for column in zip(*(r[what] for r in seen[each])))
            cells.append(f"{wall:.1f}, {spent:.1f}")
        yield f"| {what} | " + " | ".join(cells) + " |"
    least = min(row[2] for rows in seen.values() for r in rows for row in r.values())
    yield f"{rounds} rounds in turns; at least {least:.1f} cores were free before each command"
