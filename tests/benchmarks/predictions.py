"""Predictions of `--plan` beside runs: steps and time of scenes of this repository.

Each scene is planned with a pilot run, then played to its end on the same ranks, both as commands.
Scenes of the first list served to adjust the cost model; those of the second did not.
"""

import re
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from tests.support.launch import run
from vgmpi.solver.run import STOPPED

ROOT = Path(__file__).parents[2] / "runs"
ADJUSTED = (
    "splash", "castle_flood", "castle_falls", "snowball", "snowman", "two_liquids", "water_on_snow",
)  # fmt: skip
HELD_OUT = "dam_break", "sand_castle", "three_materials", "balls_duck"
MAX_STEP_ERROR, MAX_TIME_ERROR = 0.15, 0.3  # [-] relative to what was taken

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}  # [s]


class Prediction(NamedTuple):
    """Steps and time of a scene, told and taken."""

    scene: str
    told_steps: float
    taken_steps: int
    told: float  # [s]
    taken: float  # [s]

    @property
    def holds(self) -> bool:
        """Whether both are within their tolerance."""
        steps = abs(self.told_steps / self.taken_steps - 1.0) <= MAX_STEP_ERROR
        return steps and abs(self.told / self.taken - 1.0) <= MAX_TIME_ERROR


def measure(scene: str, ranks: int) -> Prediction:
    """Plan a scene with a pilot run, then play it.

    Args:
        scene: Name of a folder of runs/, or a scene file.
        ranks: Number of ranks.
    """
    path = ROOT / scene / "scene.toml" if (ROOT / scene).is_dir() else Path(scene)
    start = ["mpirun", "-n", str(ranks), sys.executable, "-m", "vgmpi", str(path)]
    plan = _output([*start, "--plan", "--pilot"])
    with tempfile.TemporaryDirectory() as folder:
        _output([*start, "-o", folder, "--overwrite", "--stop-after", "3 steps"])  # compiles
        played = _output([*start, "-o", folder, "--overwrite"])
    steps, seconds = re.search(r"([\d,]+) steps of .* in ([\d.]+) s on", played).groups()  # type: ignore[union-attr]
    told = re.search(r"  steps +(?:about )?([\d,]+)(?: to ([\d,]+))?", plan)
    duration = re.search(r"  time +(?:about )?([\d.]+) (s|min|h)\b", plan)
    if told is None or duration is None:
        raise ValueError(f"{scene}: the plan tells no time:\n{plan}")
    return Prediction(
        scene, _number(told[1]), int(_number(steps)), float(duration[1]) * UNITS[duration[2]],
        float(seconds),
    )  # fmt: skip


def _number(text: str) -> float:
    """Return a number written with commas."""
    return float(text.replace(",", ""))


def _output(command: list[str]) -> str:
    """Return what a command prints, on both streams."""
    job = run(command)
    if job.returncode not in (0, STOPPED):
        raise RuntimeError(job.stderr[-2000:])
    return job.stdout + job.stderr


def row(p: Prediction) -> str:
    """Return a row of the table."""
    return (
        f"| {p.scene} | {p.told_steps:,.0f} | {p.taken_steps:,} |"
        f" {p.told_steps / p.taken_steps:.2f} | {p.told:.0f} s | {p.taken:.0f} s |"
        f" {p.told / p.taken:.2f} |"
    )


HEAD = """| scene | steps told | taken | ratio | time told | taken | ratio |
|---|---|---|---|---|---|---|"""
