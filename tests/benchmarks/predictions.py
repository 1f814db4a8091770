"""Predictions of `--plan` beside runs: steps and time of scenes of this repository.

Each scene is planned, without and with a pilot run, then played to its end on one rank. Times are
processor times, and the speed of the processor is measured before and after each run, so that other
programs count little. Some scenes are coarser or shorter than they are given: `REDUCED`.
Scenes of the first list served to adjust the cost model; those of the second did not.
"""

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import vgmpi
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.run_estimate import predicted_seconds, step_count
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import time_step_bounds
from vgmpi.scene.scene import Scene
from vgmpi.solver.estimates.calibration import LAWS, measure_throughput
from vgmpi.solver.estimates.pilot_run import pilot_run
from vgmpi.solver.initial_particles import plan_for, prepare
from vgmpi.solver.run import Options, Runner, prepared_run

ROOT = Path(__file__).parents[2] / "runs"
ADJUSTED = (
    "splash", "castle_flood", "castle_falls", "snowball", "snowman", "two_liquids", "water_on_snow",
)  # fmt: skip
HELD_OUT = "dam_break", "sand_castle", "three_materials", "balls_duck", "faucet", "driftwood"
REDUCED = {  # overrides by which a run takes less than a minute
    "splash": ("time.end='1.5 s'",),
    **dict.fromkeys(
        ("castle_falls", "castle_flood", "faucet", "driftwood", "snowball", "snowman",
         "two_liquids", "water_on_snow", "balls_duck"),
        ("domain.cell='2 cm'",),
    ),
}  # fmt: skip
MAX_RATIO = 1.5  # [-] of the time told and taken, either way


class Prediction(NamedTuple):
    """Steps and processor time of a scene, told without and with a pilot run, and taken."""

    scene: str
    told_steps: tuple[float, float]
    taken_steps: int
    told: tuple[float, float]  # [s]
    taken: float  # [s]

    @property
    def holds(self) -> bool:
        """Whether the time told with a pilot run is within the factor."""
        return 1.0 / MAX_RATIO <= self.told[1] / self.taken <= MAX_RATIO


def measure(name: str) -> Prediction:
    """Plan a scene without and with a pilot run, then play it.

    Args:
        name: Name of a folder of runs/, or a scene file.
    """
    path = ROOT / name / "scene.toml" if (ROOT / name).is_dir() else Path(name)
    scene = vgmpi.load(path, REDUCED.get(name, ()))
    summary = prepare(scene, SerialCommunicator(), None)
    plan = plan_for(scene, summary)
    pilot = pilot_run(scene, plan, summary, quiet=True)
    before = [measure_throughput(law, scene.accuracy.precision) for law in LAWS]
    steps, taken = play(scene)
    after = [measure_throughput(law, scene.accuracy.precision) for law in LAWS]
    fluid, elastic = (0.5 * (a + b) for a, b in zip(before, after, strict=True))
    pace = Throughput(fluid, elastic, "measured beside the run")
    dt = plan.fixed_dt or time_step_bounds(scene, plan)[0][0]
    plain = predicted_seconds(scene, plan, 1, pace)
    better = plain if pilot is None else predicted_seconds(scene, plan, 1, pace, pilot)
    told_steps = float(step_count(plan, dt, 0.0))
    with_pilot = told_steps if pilot is None else pilot.steps
    return Prediction(name, (told_steps, with_pilot), steps, (plain, better), taken)


def play(scene: Scene) -> tuple[int, float]:
    """Return the steps of a run on this rank, and its processor time [s] from the first frame."""
    times: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        options = Options(Path(folder) / "out")

        def look(run: Runner) -> None:
            """Note the time at a frame."""
            times.append(time.process_time())

        options.watchers.append(look)
        with prepared_run(scene, SerialCommunicator(), options) as run:
            run.run()
            return run.simulation.step, times[-1] - times[0]


def row(p: Prediction) -> str:
    """Return a row of the table."""
    ratios = [f"{told / p.taken_steps:.2f}" for told in p.told_steps]
    ratios += [f"{told / p.taken:.2f}" for told in p.told]
    return f"| {p.scene} | {p.taken_steps:,} | {p.taken:.1f} s | {' | '.join(ratios)} |"


HEAD = """| scene | steps | time | steps told | with a pilot run | time told | with a pilot run |
|---|---|---|---|---|---|---|"""
