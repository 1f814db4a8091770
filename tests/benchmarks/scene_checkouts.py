"""Scenes of runs/ in this program and in another checkout of it, in turns.

Each checkout plays its own copy of the scene with its own defaults, in single precision. What is
compared are ns per particle and step of the stages of a step (P2G, halo, nodes, G2P, sort), without
writing and waiting, so that other programs on the machine matter less. All rounds take the same
steps, and a round that compiles comes before them.
"""

import csv
import re
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.support.launch import ROOT, mpirun
from vgmpi.solver.run_outcome import STOPPED
from vgmpi.tools.bench.benchmark_case import BenchError

SCENES = ("splash", "snowball", "sandbox", "castle_flood")
STAGES = ("p2g", "halo", "grid", "g2p", "sort")
TIMED_STEPS = re.compile(r"(\d+) steps of ([\d,]+) particles")


class SceneSpeed(NamedTuple):
    """Speed of a scene in one round."""

    ns: float  # [ns] per particle and step, summed over ranks
    simulated: float  # [s] simulated by the steps that were timed


def play_part(tree: Path, scene: str, steps: int, ranks: int, out: Path) -> SceneSpeed:
    """Play the first steps of a scene of a checkout.

    Args:
        tree: Folder of the checkout.
        scene: Name of the folder below runs/.
        steps: Number of steps.
        ranks: Number of ranks.
        out: Folder of the run.

    Raises:
        BenchError: If the run ends otherwise than by its limit.
    """
    job = mpirun(
        ranks, "-m", "vgmpi", f"runs/{scene}/scene.toml", "--set", "accuracy.precision=single",
        "--stop-after", f"{steps} steps", "--profile", "-o", out, "--overwrite",
        env={"PYTHONPATH": str(tree)}, cwd=tree,
    )  # fmt: skip
    text = job.stdout + job.stderr
    summary = TIMED_STEPS.search(text)
    if job.returncode != STOPPED or summary is None:
        lines = text.strip().splitlines() or [f"exit code {job.returncode}"]
        raise BenchError(f"{tree}, {scene}: {lines[0]}")
    with open(out / "profile.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    seconds = sum(float(row[stage]) for row in rows for stage in STAGES)
    count, particles = int(summary[1]), int(summary[2].replace(",", ""))
    last = re.findall(r"at step \d+, ([\d.eE+-]+) s", text)[-1]
    return SceneSpeed(1e9 * seconds / count / particles, float(last))


def compare_scenes(
    tree: Path, scenes: list[str], steps: int, ranks: int, rounds: int, tell: Callable
) -> Iterator[str]:
    """Yield a line per scene: both speeds and their ratios.

    Args:
        tree: The other checkout.
        scenes: Names of folders below runs/.
        steps: Number of steps of each part.
        ranks: Number of ranks.
        rounds: Number of rounds; one more comes before them and compiles.
        tell: Called with a line of progress.
    """
    yield "| scene | ns | other | ratio | ratio of steps per second | ratio of times |"
    yield "|---|---|---|---|---|---|"
    other = tree.resolve()
    with tempfile.TemporaryDirectory(prefix="vgmpi-scenes-") as folder:
        for scene in scenes:
            pairs: list[tuple[SceneSpeed, SceneSpeed]] = []
            for k in range(rounds + 1):
                trees = (ROOT, other) if k % 2 == 0 else (other, ROOT)
                turn = {t: play_part(t, scene, steps, ranks, Path(folder)) for t in trees}
                pair = turn[ROOT], turn[other]
                tell(f"{scene}, round {k}: {pair[0].ns:.1f} and {pair[1].ns:.1f} ns")
                pairs += [pair] if k else []
            yield format_pairs(scene, pairs)


def format_pairs(scene: str, pairs: list[tuple[SceneSpeed, SceneSpeed]]) -> str:
    """Return the row of a scene: medians, and the range of the ratio of neighbors in time."""
    ratios = [own.ns / other.ns for own, other in pairs]
    pace = [other.simulated / own.simulated for own, other in pairs]
    time = [a * b for a, b in zip(ratios, pace, strict=True)]
    own, other = (np.median([pair[k].ns for pair in pairs]) for k in (0, 1))
    return (
        f"| {scene} | {own:.1f} | {other:.1f} | {np.median(ratios):.2f}"
        f" ({min(ratios):.2f} to {max(ratios):.2f}) | {np.median(pace):.2f} |"
        f" {np.median(time):.2f} |"
    )
