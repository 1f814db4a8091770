"""Model of a step's time by stage beside steps as they are on one rank; the costs that fit best.

Scenes of runs/ are played on one rank. At some times 300 steps are timed by stage, and told by
vgmpi/planning/cost/feature_costs.py from where the particles are then. The model is linear in the
costs of vgmpi/planning/step_costs.py: those that fit the measured times are found by least squares
of relative errors, held to the present values by a small weight. Scenes that predictions.HELD_OUT
names do not enter the fit.
"""

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tests.benchmarks.predictions import HELD_OUT, ROOT
from tests.support.simulate import advance, begin, by_id
from vgmpi.planning.cost.feature_costs import step_time
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.planning.plan import Plan
from vgmpi.planning.step_costs import COSTS, STAGES, StageCost, StepCosts
from vgmpi.scene.loader import load
from vgmpi.scene.scene import Scene
from vgmpi.solver.diagnostics.progress import Clock
from vgmpi.solver.estimates.calibration import host_throughput
from vgmpi.solver.estimates.measure_proximity import measure_proximity
from vgmpi.solver.simulation import Simulation

TIMES = {  # scene -> last of the three times [s]
    "two_liquids": 0.8, "castle_falls": 1.3, "splash": 0.8, "water_on_snow": 0.35,
    "snowball": 0.4, "castle_flood": 0.4, "sandbox": 0.8, "sand_castle": 1.0,
    "three_materials": 0.9, "balls_duck": 0.4, "dam_break": 0.4, "bench/layer": 0.2,
}  # fmt: skip
ROUNDS, STEPS = 5, 60  # the median round counts
PRIOR_WEIGHT = 0.1  # [-] weight of a relative change of a cost by a factor of e
START_WEIGHT = 0.3  # [-] weight of the start, which lasts for a few steps
MAX_ERROR = 0.25  # [-] of a stage's time told
MIN_SHARE = 0.08  # [-] of a step, below which a stage has no ratio


class StepSample(NamedTuple):
    """A step of a scene at one time."""

    scene: str
    time: float  # [s]
    predicted: StageCost  # [s] by the model
    measured: StageCost  # [s]
    amounts: np.ndarray  # (costs,) [s] time of a stage in which every cost but one is zero
    weight: float  # [-] in the fit

    def ratios(self) -> list[float]:
        """Return told over measured in all and by stage; nan for stages that take little."""
        pairs = [(self.predicted.total, self.measured.total)]
        pairs += zip(astuple(self.predicted), astuple(self.measured), strict=True)
        least = MIN_SHARE * self.measured.total
        return [told / m if m >= least else np.nan for told, m in pairs]


def cost_names(costs: StepCosts = COSTS) -> Iterator[tuple[str, str]]:
    """Yield the names of all costs: field, and its part or an empty name."""
    for name, value in costs._asdict().items():
        for part in [""] if isinstance(value, StageCost) else value._fields:
            yield name, part


def cost_of(costs: StepCosts, name: str, part: str) -> StageCost:
    """Return one of the costs."""
    value = getattr(costs, name)
    return getattr(value, part) if part else value


def with_cost(costs: StepCosts, name: str, part: str, cost: StageCost) -> StepCosts:
    """Return the costs with another value of one."""
    return costs._replace(**{name: getattr(costs, name)._replace(**{part: cost}) if part else cost})


def zero_costs() -> StepCosts:
    """Return costs of which all are zero."""
    costs = COSTS
    for name, part in cost_names():
        costs = with_cost(costs, name, part, StageCost())
    return costs


def current_plan(scene: Scene, simulation: Simulation, colliders: list) -> Plan:
    """Return the plan of a simulation with its particles where they are now."""
    plan, (x, ids) = simulation.plan, by_id(simulation, "x", "id")
    count = np.bincount(simulation.object_of(ids), minlength=len(plan.count))
    bodies = np.split(x, np.cumsum(count)[:-1])
    around = measure_proximity(scene, bodies, colliders)
    return plan.with_particles(tuple(count.tolist()), around)


def stage_seconds(simulation: Simulation) -> StageCost:
    """Return the wall time of a step by stage [s], of the median round."""
    rounds = []
    for _ in range(ROUNDS):
        clock = simulation.clock = Clock()
        for _ in range(STEPS):
            simulation.advance(0.9 * simulation.bound())
        rounds.append(StageCost(*(clock.spent[stage] / STEPS for stage in STAGES)))
    simulation.clock = None
    sort = float(np.mean([r.sort for r in rounds]))  # some rounds have none
    return replace(sorted(rounds, key=lambda r: r.total - r.sort)[ROUNDS // 2], sort=sort)


def amounts_of(scene: Scene, plan: Plan, pace: Throughput) -> np.ndarray:
    """Return the factors of all costs in the time of a step [s], the same for every stage."""
    zero, one = zero_costs(), StageCost(p2g=1.0)
    told = [
        step_time(scene, plan, pace, with_cost(zero, name, part, one)).p2g
        for name, part in cost_names()
    ]
    return 1e-9 * np.array(told)


def samples_of(name: str) -> Iterator[StepSample]:
    """Yield the samples of a scene: at its start, in the middle and at its last time."""
    folder = ROOT / name
    path = folder / "scene.toml" if folder.is_dir() else folder.with_suffix(".toml")
    scene = load(path)
    pace = host_throughput(scene.accuracy.precision)
    with tempfile.TemporaryDirectory() as copy:
        shutil.copytree(path.parent, copy, ignore=shutil.ignore_patterns("out"), dirs_exist_ok=True)
        simulation, made = begin(Path(copy), path.read_text())
        for k, goal in enumerate(np.linspace(0.0, TIMES[name], 3)):
            advance(simulation, max(float(goal), simulation.bound()))
            plan = current_plan(scene, simulation, made.colliders)
            told = 1e-9 * step_time(scene, plan, pace)
            measured, amounts = stage_seconds(simulation), amounts_of(scene, plan, pace)
            weight = START_WEIGHT if k == 0 else 1.0
            yield StepSample(name, float(goal), told, measured, amounts, weight)


def fit_costs(samples: list[StepSample]) -> StepCosts:
    """Return the costs that fit the samples of scenes that are not held out."""
    chosen = [s for s in samples if s.scene not in HELD_OUT]
    amounts = np.array([s.amounts for s in chosen])
    weight = np.array([s.weight for s in chosen])
    now = np.array([astuple(cost_of(COSTS, *names)) for names in cost_names()])
    fitted = np.zeros_like(now)
    for k, stage in enumerate(STAGES):
        measured = np.array([getattr(s.measured, stage) for s in chosen])
        least = MIN_SHARE * np.array([s.measured.total for s in chosen])

        def residuals(y, k=k, measured=measured, least=least):
            error = amounts @ (now[:, k] * np.exp(y)) - measured
            return np.append(weight * error / np.maximum(measured, least), PRIOR_WEIGHT * y)

        fitted[:, k] = now[:, k] * np.exp(least_squares(residuals, np.zeros(len(now))).x)
    costs = COSTS
    for names, row in zip(cost_names(), fitted, strict=True):
        costs = with_cost(costs, *names, StageCost(*row))
    return costs


def run(scenes: list[str]) -> None:
    """Print the table of the samples and the costs that fit them.

    Args:
        scenes: Names of folders of runs/.
    """
    titles = "scene", "time", "step told", "measured", "step", *STAGES
    print("| " + " | ".join(titles) + " |\n" + "|---" * len(titles) + "|")
    samples: list[StepSample] = []
    for name in scenes:
        for s in samples_of(name):
            samples.append(s)
            ratios = " | ".join("" if np.isnan(ratio) else f"{ratio:.2f}" for ratio in s.ratios())
            print(
                f"| {name} | {s.time:.2f} s | {1e3 * s.predicted.total:.2f} ms"
                f" | {1e3 * s.measured.total:.2f} ms | {ratios} |",
                flush=True,
            )
    ratios = np.array([s.ratios() for s in samples])
    held = np.abs(ratios - 1.0) <= MAX_ERROR
    for k, title in enumerate(("step", *STAGES)):
        known = ~np.isnan(ratios[:, k])
        print(f"{title}: {held[known, k].sum()} of {known.sum()} within {100 * MAX_ERROR:.0f} %")
    if all(s.scene in HELD_OUT for s in samples):
        return
    costs = fit_costs(samples)
    for names in cost_names():
        old, new = cost_of(COSTS, *names), cost_of(costs, *names)
        numbers = ", ".join(f"{a:.3g} -> {b:.3g}" for a, b in zip(astuple(old), astuple(new)))
        print(f"{'.'.join(filter(None, names))}: {numbers}")
