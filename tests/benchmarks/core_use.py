"""One rank, ranks and threads on the same scenes in turns, and what starting ranks costs.

Parts of scenes are played by processes of their own. Of their steps the processor time on the
longest path counts (critical_path.py), so that other programs on the machine change little. A start
is a run of one step, with all that its processes take: it waits until so many cores are free, and
tells how many were.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.support.launch import OPEN_MPI, ROOT
from vgmpi.runtime.process_limits import FreeCores
from vgmpi.solver.run_outcome import DONE, STOPPED
from vgmpi.tools.bench.benchmark_case import BenchError

SCENES = {  # overrides, and the steps of a part
    "splash": ((), 60),
    "dam_break": ((), 150),
    "castle_falls": (("domain.cell='2 cm'",), 100),
    "ball": ((), 150),
}
USES = {"1 rank": (1, 1), "2 ranks": (2, 1), "2 threads": (1, 2)}  # ranks, threads
README_SCENE = re.compile(r"```toml\n(.*?)```", re.DOTALL)


class Start(NamedTuple):
    """A run of one step."""

    wall: float  # [s] of the whole process
    processor: float  # [s] processor time of the process and its ranks


def scene_file(name: str, folder: Path) -> Path:
    """Return the file of a scene: of runs/, or the one of the README, written into a folder."""
    if name != "ball":
        return ROOT / "runs" / name / "scene.toml"
    found = README_SCENE.search((ROOT / "README.md").read_text())
    assert found is not None
    path = folder / "scene.toml"
    path.write_text(found[1])
    return path


def wait_for_cores(cores: float, patience: float) -> float:
    """Wait until other programs leave so many cores, or until patience [s] is over.

    Returns:
        The number of free cores at last.
    """
    end = time.monotonic() + patience
    while True:
        meter = FreeCores()
        time.sleep(1.0)
        free = meter.measure()
        if free >= cores or time.monotonic() > end:
            return free
        time.sleep(2.0)


def start_run(scene: Path, ranks: int) -> Start:
    """Play one step of a scene in a process of its own, as a user starts it.

    Args:
        scene: Scene file.
        ranks: Number of ranks.

    Raises:
        BenchError: If the run fails.
    """
    environment = {**os.environ, **OPEN_MPI, "PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as out:
        command = [sys.executable, "-m", "vgmpi", scene, "--ranks", str(ranks), "-o", out]
        before, began = os.times(), time.monotonic()
        job = subprocess.run(
            [*command, "--overwrite", "--stop-after", "1 steps"],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        wall, after = time.monotonic() - began, os.times()
    if job.returncode not in (DONE, STOPPED):
        raise BenchError(f"{scene}: {(job.stderr.splitlines() or ['no output'])[-1]}")
    return Start(wall, sum(after[2:4]) - sum(before[2:4]))


def step_seconds(scene: Path, overrides: tuple[str, ...], steps: int, use: str) -> float:
    """Return the processor time on the longest path of a step [s] (critical_path.py).

    Args:
        scene: Scene file.
        overrides: Values of `--set`.
        steps: Number of steps.
        use: Name of the use of the cores.

    Raises:
        BenchError: If the run fails.
    """
    ranks, threads = USES[use]
    program = [sys.executable, "-m", "tests.benchmarks.critical_path"]
    program = ["mpirun", "-n", str(ranks), *program] if ranks > 1 else program
    environment = {**os.environ, **OPEN_MPI, "PYTHONPATH": str(ROOT)}
    job = subprocess.run(
        [*program, scene, str(steps), str(threads), *overrides], env=environment, cwd=ROOT,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if job.returncode:
        raise BenchError(f"{scene}: {(job.stderr.splitlines() or ['no output'])[-1]}")
    return float(json.loads(job.stdout.splitlines()[-1])["seconds"])


def compare_uses(names: list[str], rounds: int, say: Callable) -> Iterator[str]:
    """Yield a row per scene: times of a step, and ratios of neighbors in time.

    Args:
        names: Scenes.
        rounds: Number of rounds; one more comes before them and compiles.
        say: Called with a line of progress.
    """
    yield "| scene | 1 rank [ms per step] | 2 ranks: times as fast | 2 threads: times as fast |"
    yield "|---|---|---|---|"
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as folder:
        for name in names:
            scene, (overrides, steps) = scene_file(name, Path(folder)), SCENES[name]
            found: dict[str, list[float]] = {use: [] for use in USES}
            for k in range(rounds + 1):
                for use in list(USES) if k % 2 else list(USES)[::-1]:
                    seconds = step_seconds(scene, overrides, steps if k else 1, use)
                    found[use] += [seconds] if k else []
                    say(f"{name}, round {k}, {use}: {1e3 * seconds:.2f} ms")
            one = np.array(found["1 rank"])
            words = [name, f"{1e3 * np.median(one):.2f}"]
            for use in ("2 ranks", "2 threads"):
                ratios = one / np.array(found[use])
                words.append(f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})")
            yield "| " + " | ".join(words) + " |"


def measure_start(rounds: int, free: float, patience: float, say: Callable) -> Iterator[str]:
    """Yield lines on what a start on two ranks costs over one on one rank.

    Args:
        rounds: Number of rounds; one more comes before them and compiles.
        free: Cores to wait for before each part.
        patience: Longest wait [s].
        say: Called with a line of progress.
    """
    costs, walls, paths = [], [], []
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as folder:
        scene = scene_file("ball", Path(folder))
        for k in range(rounds + 1):
            pair = {}
            for use in ("1 rank", "2 ranks") if k % 2 else ("2 ranks", "1 rank"):
                cores = wait_for_cores(free, patience) if k else 0.0
                pair[use] = part = start_run(scene, USES[use][0])
                say(f"round {k}, {use}: wall {part.wall:.2f} s, processor {part.processor:.2f} s,"
                    f" {cores:.1f} cores free")  # fmt: skip
            if k:
                costs.append(pair["2 ranks"].processor - pair["1 rank"].processor)
                paths.append(costs[-1] - pair["1 rank"].processor)
                walls.append(pair["2 ranks"].wall - pair["1 rank"].wall)
    yield "a run of one step on two ranks, over the same on one rank [s]:"
    rows = ("processor time", costs), ("less that of the second rank", paths), ("wall time", walls)
    for what, values in rows:
        least, most = min(values), max(values)
        yield f"  {what:28s} median {np.median(values):.2f} ({least:.2f} to {most:.2f})"
