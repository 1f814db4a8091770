"""Predictions of `--plan` beside runs: steps and time of scenes of this repository.

Each scene is planned with a pilot run, then played to its end on so many ranks.
Scenes of the first list served to adjust the cost model; those of the second did not.
"""

import re
import tempfile
from pathlib import Path
from typing import NamedTuple

import vgmpi
from tests.support.launch import mpirun
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.run_estimate import predicted_seconds
from vgmpi.solver.estimates.calibration import host_throughput
from vgmpi.solver.estimates.pilot_run import pilot_run
from vgmpi.solver.initial_particles import plan_for, prepare

ROOT = Path(__file__).parents[2] / "runs"
ADJUSTED = (
    "splash", "castle_flood", "castle_falls", "snowball", "snowman", "two_liquids", "water_on_snow",
)  # fmt: skip
HELD_OUT = "dam_break", "sand_castle", "three_materials", "balls_duck"
MAX_STEP_ERROR, MAX_TIME_ERROR = 0.15, 0.3  # [-] relative to what was taken


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
    steps, seconds = predict(path, ranks)
    with tempfile.TemporaryDirectory() as folder:
        job = mpirun(ranks, "-m", "vgmpi", path, "-o", folder, "--overwrite")
    taken = re.search(r"([\d,]+) steps of .* in ([\d.]+) s on", job.stdout + job.stderr)
    if taken is None:
        raise RuntimeError(job.stderr[-2000:])
    return Prediction(scene, steps, int(taken[1].replace(",", "")), seconds, float(taken[2]))


def predict(path: Path, ranks: int) -> tuple[float, float]:
    """Return the steps and the time [s] that `--plan --pilot` tells of a scene file."""
    scene = vgmpi.load(path)
    summary = prepare(scene, SerialCommunicator(), None)
    plan, pace = plan_for(scene, summary), host_throughput(scene.accuracy.precision)
    pilot = pilot_run(scene, plan, summary)
    if pilot is None:
        raise ValueError(f"{path}: no pilot run is possible")
    return pilot.steps, predicted_seconds(scene, plan, ranks, pace, pilot)


def row(p: Prediction) -> str:
    """Return a row of the table."""
    return (
        f"| {p.scene} | {p.told_steps:,.0f} | {p.taken_steps:,} |"
        f" {p.told_steps / p.taken_steps:.2f} | {p.told:.0f} s | {p.taken:.0f} s |"
        f" {p.told / p.taken:.2f} |"
    )


HEAD = """| scene | steps told | taken | ratio | time told | taken | ratio |
|---|---|---|---|---|---|---|"""
