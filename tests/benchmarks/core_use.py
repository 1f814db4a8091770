"""One rank, ranks and threads on the same scenes in turns, and what starting ranks costs.

A part of a scene is played by processes of its own. Times of a step are those of the program's own
table, without start and compilation; a start is a run of one step. Before each part the benchmark
waits until so many cores are free, and tells how many were: ranks that share a core with other
programs wait for each other.
"""

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
from vgmpi.apps.bench.benchmark_case import BenchError
from vgmpi.runtime.processor_cores import FreeCores
from vgmpi.solver.run import DONE, STOPPED

SCENES = {  # overrides, and the steps of a part
    "splash": ((), 120),
    "dam_break": ((), 200),
    "castle_falls": (("domain.cell='2 cm'",), 200),
    "ball": ((), 300),
}
USES = {
    "1 rank": ("--ranks", "1"),
    "2 ranks": ("--ranks", "2"),
    "2 threads": ("--ranks", "1", "--threads", "2"),
}
README_SCENE = re.compile(r"```toml\n(.*?)```", re.DOTALL)
STEPS_LINE = re.compile(r"(\d+) steps of ([\d,]+) particles in ([\d.]+) s")


class Part(NamedTuple):
    """A part of a scene that was played."""

    step: float  # [s] wall time of a step, by the table of the run
    wall: float  # [s] of the whole process
    processor: float  # [s] processor time of the process and its ranks
    free: float  # cores that other programs left before it


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


def play_part(
    scene: Path, use: tuple[str, ...], overrides: tuple[str, ...], steps: int, free: float
) -> Part:
    """Play the first steps of a scene in a process of its own.

    Args:
        scene: Scene file.
        use: Flags of the command on ranks and threads.
        overrides: Values of `--set`.
        steps: Number of steps.
        free: Cores that other programs leave.

    Raises:
        BenchError: If the run ends otherwise than by its limit.
    """
    flags = [word for override in overrides for word in ("--set", override)]
    environment = {**os.environ, **OPEN_MPI, "PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as out:
        command = [sys.executable, "-m", "vgmpi", scene, *use, *flags, "-o", out, "--overwrite"]
        before, began = os.times(), time.monotonic()
        job = subprocess.run(
            [*command, "--stop-after", f"{steps} steps"],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        wall, after = time.monotonic() - began, os.times()
    line = STEPS_LINE.search(job.stdout)
    if job.returncode not in (DONE, STOPPED) or line is None:
        raise BenchError(f"{scene}: {(job.stderr.splitlines() or ['no output'])[-1]}")
    processor = sum(after[2:4]) - sum(before[2:4])
    return Part(float(line[3]) / int(line[1]), wall, processor, free)


def compare_uses(
    names: list[str], rounds: int, free: float, patience: float, say: Callable
) -> Iterator[str]:
    """Yield a row per scene: times of a step, and ratios of neighbors in time.

    Args:
        names: Scenes.
        rounds: Number of rounds; one more comes before them and compiles.
        free: Cores to wait for before each part.
        patience: Longest wait [s].
        say: Called with a line of progress.
    """
    yield "| scene | 1 rank [ms/step] | 2 ranks: times as fast | 2 threads | free cores, least |"
    yield "|---|---|---|---|---|"
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as folder:
        for name in names:
            scene, (overrides, steps) = scene_file(name, Path(folder)), SCENES[name]
            parts: dict[str, list[Part]] = {use: [] for use in USES}
            for k in range(rounds + 1):
                for use in list(USES) if k % 2 else list(USES)[::-1]:
                    cores = wait_for_cores(free, patience) if k else 0.0
                    part = play_part(scene, USES[use], overrides, steps if k else 1, cores)
                    say(f"{name}, round {k}, {use}: {1e3 * part.step:.1f} ms a step, {cores:.1f}"
                        " cores free")  # fmt: skip
                    parts[use] += [part] if k else []
            yield format_row(name, parts)


def format_row(name: str, parts: dict[str, list[Part]]) -> str:
    """Return the row of a scene.

    Args:
        name: The scene.
        parts: Parts that were played, by use of the cores.
    """
    one = np.array([part.step for part in parts["1 rank"]])
    words = [name, f"{1e3 * np.median(one):.1f}"]
    for use in ("2 ranks", "2 threads"):
        ratios = one / np.array([part.step for part in parts[use]])
        words.append(f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})")
    words.append(f"{min(part.free for rows in parts.values() for part in rows):.1f}")
    return "| " + " | ".join(words) + " |"


def measure_start(rounds: int, free: float, patience: float, say: Callable) -> Iterator[str]:
    """Yield lines on what a start on two ranks costs over one on one rank.

    Args:
        rounds: Number of rounds; one more comes before them and compiles.
        free: Cores to wait for before each part.
        patience: Longest wait [s].
        say: Called with a line of progress.
    """
    costs, walls = [], []
    with tempfile.TemporaryDirectory(prefix="vgmpi-cores-") as folder:
        scene = scene_file("ball", Path(folder))
        for k in range(rounds + 1):
            pair = {}
            for use in ("1 rank", "2 ranks") if k % 2 else ("2 ranks", "1 rank"):
                cores = wait_for_cores(free, patience) if k else 0.0
                pair[use] = part = play_part(scene, USES[use], (), 1, cores)
                say(f"round {k}, {use}: wall {part.wall:.2f} s, processor {part.processor:.2f} s,"
                    f" {cores:.1f} cores free")  # fmt: skip
            if k:
                costs.append(pair["2 ranks"].processor - pair["1 rank"].processor)
                walls.append(pair["2 ranks"].wall - pair["1 rank"].wall)
    yield "a run of one step on two ranks, over the same on one rank [s]:"
    for what, values in (("processor time", costs), ("wall time", walls)):
        least, most = min(values), max(values)
        yield f"  {what:14s} median {np.median(values):.2f} ({least:.2f} to {most:.2f})"
