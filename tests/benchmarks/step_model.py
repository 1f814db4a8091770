"""Model of a step's time beside steps as they are, on one rank, and the constants that fit best.

Scenes of runs/ are played on one rank. At some times 300 steps are timed, and told by
vgmpi/planning/cost/feature_costs.py from where the particles are then. The model is linear in its
constants: those that fit the measured times are found by least squares of relative errors, held to
the present values by a small weight. Scenes that predictions.HELD_OUT names do not enter the fit.
"""

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tests.benchmarks.predictions import HELD_OUT, ROOT
from tests.support.simulate import advance, begin, by_id
from vgmpi.planning.cost import feature_costs
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import Plan
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.estimates.calibration import host_throughput
from vgmpi.solver.estimates.measure_proximity import measure_proximity
from vgmpi.solver.simulation import Simulation

TIMES = {  # scene -> last of the three times [s]
    "two_liquids": 0.8, "castle_falls": 1.3, "splash": 0.8, "water_on_snow": 0.35,
    "snowball": 0.4, "castle_flood": 0.4, "sand_castle": 1.0, "three_materials": 0.9,
    "balls_duck": 0.4, "dam_break": 0.5,
}  # fmt: skip
PAIRS = "SURFACE_CONTACT_COST", "CONTACT_COST", "MIXING_COST", "DRAG_COST"
CONSTANTS = [("BLOCK_COST", None)] + [(n, f) for n in PAIRS for f in ("particle", "block", "nodes")]
PRIOR_WEIGHT = 0.1  # [-] weight of a relative change of a constant by a factor of e
START_WEIGHT = 0.3  # [-] weight of the start, which lasts for a few steps


class StepSample(NamedTuple):
    """A step of a scene at one time."""

    scene: str
    time: float  # [s]
    told: float  # [s] by the model
    measured: float  # [s]
    fixed: float  # [s] of `told` that does not depend on the constants
    parts: np.ndarray  # (constants,) [s] derivative by each constant
    weight: float  # [-] in the fit


def current_plan(scene: Scene, simulation: Simulation, colliders: list) -> Plan:
    """Return the plan of a simulation with its particles where they are now."""
    plan, (x, ids) = simulation.plan, by_id(simulation, "x", "id")
    count = np.bincount(simulation.object_of(ids), minlength=len(plan.count))
    bodies = np.split(x, np.cumsum(count)[:-1])
    around = measure_proximity(scene, bodies, colliders)
    return replace(plan, count=tuple(count.tolist()), surroundings=around)


def told_seconds(
    scene: Scene, plan: Plan, pace: Throughput, constants: np.ndarray | None = None
) -> float:
    """Return the time of a step [s] by the model, with other constants if they are given."""
    before = {name: getattr(feature_costs, name) for name, _ in CONSTANTS}
    try:
        for (name, field), value in zip(CONSTANTS, () if constants is None else constants):
            old = getattr(feature_costs, name)
            new = float(value) if field is None else old._replace(**{field: float(value)})
            setattr(feature_costs, name, new)
        return 1e-9 * feature_costs.step_ns(scene, plan, pace)
    finally:
        for name, value in before.items():
            setattr(feature_costs, name, value)


def present_constants() -> np.ndarray:
    """Return the constants of the model, shape (constants,)."""
    values = [(getattr(feature_costs, name), field) for name, field in CONSTANTS]
    return np.array([v if field is None else getattr(v, field) for v, field in values])


def step_seconds(simulation: Simulation) -> float:
    """Return the wall time of a step [s], the median of three hundred steps in parts."""
    parts = []
    for _ in range(3):
        start = time.perf_counter()
        for _ in range(100):
            simulation.advance(0.9 * simulation.bound())
        parts.append((time.perf_counter() - start) / 100)
    return float(np.median(parts))


def samples_of(name: str) -> list[StepSample]:
    """Return the samples of a scene: at its start, in the middle and at its last time."""
    path = ROOT / name / "scene.toml"
    scene = load(path)
    simulation, made = begin(path.parent, path.read_text())
    pace = host_throughput(scene.accuracy.precision)
    result = []
    for k, goal in enumerate(np.linspace(0.0, TIMES[name], 3)):
        advance(simulation, max(float(goal), simulation.bound()))
        plan = current_plan(scene, simulation, made.colliders)
        told, zero = told_seconds(scene, plan, pace), np.zeros(len(CONSTANTS))
        fixed = told_seconds(scene, plan, pace, zero)
        parts = [told_seconds(scene, plan, pace, row) - fixed for row in np.eye(len(CONSTANTS))]
        weight = START_WEIGHT if k == 0 else 1.0
        measured = step_seconds(simulation)
        result.append(StepSample(name, goal, told, measured, fixed, np.array(parts), weight))
    return result


def fit_constants(samples: list[StepSample]) -> np.ndarray:
    """Return the constants that fit the samples of scenes that are not held out."""
    chosen = [s for s in samples if s.scene not in HELD_OUT]
    now = present_constants()

    def residuals(y):
        told = [s.fixed + s.parts @ (now * np.exp(y)) for s in chosen]
        return np.append(
            [s.weight * (t / s.measured - 1.0) for s, t in zip(chosen, told, strict=True)],
            PRIOR_WEIGHT * y,
        )

    return now * np.exp(least_squares(residuals, np.zeros(len(now))).x)


def run(scenes: list[str]) -> None:
    """Print the table of the samples and the constants that fit them.

    Args:
        scenes: Names of folders of runs/.
    """
    print("| scene | time | step told | measured | ratio |\n|---|---|---|---|---|")
    samples: list[StepSample] = []
    for name in scenes:
        for s in samples_of(name):
            samples.append(s)
            print(
                f"| {name} | {s.time:.2f} s | {1e3 * s.told:.2f} ms | {1e3 * s.measured:.2f} ms |"
                f" {s.told / s.measured:.2f} |",
                flush=True,
            )
    if all(s.scene in HELD_OUT for s in samples):
        return
    fitted = fit_constants(samples)
    for (name, field), old, new in zip(CONSTANTS, present_constants(), fitted, strict=True):
        print(f"{name}{'.' + field if field else ''}: {old:g}, fits best {new:.3g}")
