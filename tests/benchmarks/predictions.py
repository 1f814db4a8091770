"""What `vgmpi plan` tells beside runs: steps and time of twelve scenes that differ.

Each scene is planned, without a pilot run as at the start of a run, and with the one that
`vgmpi plan` makes by itself. Then it is played to its end on one rank. Times are processor times,
and the speed of the processor is measured before and after each run, so that other programs count
little. Most scenes are coarser or shorter than they are given: `SCENES`. Those of `HELD_OUT` did
not serve to adjust the cost model.
"""

import math
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import vgmpi
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.run_estimate import (
    expected_step,
    predicted_seconds,
    step_count,
    step_seconds,
)
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import Plan
from vgmpi.scene.scene import Scene
from vgmpi.solver.compile_kernels import compile_kernels
from vgmpi.solver.estimates.calibration import LAWS, measure_throughput
from vgmpi.solver.estimates.pilot_run import default_pilot_run
from vgmpi.solver.initial_particles import plan_for, prepare
from vgmpi.solver.run import Runner, prepared_run
from vgmpi.solver.run_options import Options

ROOT = Path(__file__).parents[2] / "runs"
POURED = "tests/benchmarks/scenes/honey_and_water.toml"
EGG = "tests/benchmarks/scenes/egg.toml"
SCENES = {  # overrides by which a run takes less than a minute
    "splash": ("time.end='1 s'",),
    "castle_falls": ("domain.cell='2 cm'",),
    "castle_flood": ("domain.cell='2 cm'",),
    "faucet": ("domain.cell='2 cm'", "time.end='1 s'"),
    EGG: (),
    POURED: (),
    "snowman": ("domain.cell='2 cm'",),
    "sandbox": ("domain.cell='2 cm'", "time.end='1.6 s'"),
    "two_liquids": ("domain.cell='2 cm'",),
    "rubber_sheet": ("domain.cell='1 cm'", "time.end='1.3 s'"),
    "honey_dipper": ("time.end='1.2 s'",),
    "water_wheel": ("time.end='0.6 s'",),
}
HELD_OUT = {
    "dam_break": (),
    "snowball": ("domain.cell='2 cm'",),
    "bouncing_ball": (),
    "sand_castle": (),
    "three_materials": (),
    "water_on_snow": ("domain.cell='2 cm'",),
    "balls_duck": ("domain.cell='2 cm'",),
    "driftwood": ("domain.cell='2 cm'",),
}
REDUCED = SCENES | HELD_OUT
MAX_RATIO = 1.5  # [-] of the time told and taken, either way


class Prediction(NamedTuple):
    """Steps and processor time of a scene, told and taken."""

    scene: str
    predicted_steps: tuple[float, float]  # by the first lines of a run, and by `vgmpi plan`
    taken_steps: int
    predicted: tuple[float, float]  # [s] the same
    taken: float  # [s]
    pilot_seconds: float  # [s] processor time of the pilot run; 0: `vgmpi plan` makes none

    @property
    def is_accurate(self) -> bool:
        """Whether steps and time told by `vgmpi plan` are within the factor."""
        ratios = self.predicted_steps[1] / self.taken_steps, self.predicted[1] / self.taken
        return all(1.0 / MAX_RATIO <= ratio <= MAX_RATIO for ratio in ratios)


def measure(name: str) -> Prediction:
    """Plan a scene as `vgmpi plan` does once kernels are compiled, then play it.

    Args:
        name: Name of a folder of runs/, or a scene file.
    """
    path = ROOT / name / "scene.toml" if (ROOT / name).is_dir() else Path(name)
    scene = vgmpi.load(path, REDUCED.get(name, ()))
    summary = prepare(scene, SerialCommunicator(), None)
    plan = plan_for(scene, summary)
    compile_kernels(plan, SerialCommunicator())
    before = [measure_throughput(law, scene.accuracy.precision) for law in LAWS]
    start = time.process_time()
    pilot = default_pilot_run(scene, plan, summary, Throughput(*before, "measured before it"))
    pilot_seconds = time.process_time() - start if pilot is not None else 0.0
    steps, taken = play(scene)
    after = [measure_throughput(law, scene.accuracy.precision) for law in LAWS]
    fluid, elastic = (0.5 * (a + b) for a, b in zip(before, after, strict=True))
    pace = Throughput(fluid, elastic, "measured beside the run")
    predicted_steps, plain = told_by_run(scene, plan, pace)
    better = plain if pilot is None else predicted_seconds(scene, plan, 1, pace, pilot)
    with_pilot = predicted_steps if pilot is None else pilot.steps
    all_steps = (predicted_steps, with_pilot)
    return Prediction(name, all_steps, steps, (plain, better), taken, pilot_seconds)


def told_by_run(scene: Scene, plan: Plan, pace: Throughput) -> tuple[float, float]:
    """Return steps and time [s] without a pilot run; the geometric middle where a range is told."""
    seconds = predicted_seconds(scene, plan, 1, pace)
    few, many = (
        step_count(plan, expected_step(scene, plan, stiffened), 0.0) for stiffened in (False, True)
    )
    middle = math.sqrt(few * many)
    each = step_seconds(scene, plan, 1, pace, None)
    return middle, seconds + (middle - few) * each


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
    ratios = [f"{told / p.taken_steps:.2f}" for told in p.predicted_steps]
    ratios += [f"{told / p.taken:.2f}" for told in p.predicted]
    pilot = f"{p.pilot_seconds:.1f} s" if p.pilot_seconds else "none"
    return f"| {p.scene} | {p.taken_steps:,} | {p.taken:.1f} s | {' | '.join(ratios)} | {pilot} |"


HEAD = """| scene | steps | time | steps: run tells | plan | time: run tells | plan | pilot run |
|---|---|---|---|---|---|---|---|"""
