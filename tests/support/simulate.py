"""A simulation in this process, without files, for tests of the physics."""

from pathlib import Path

import numpy as np

from tests.support.small_scenes import scene
from vgmpi.features.inlets_outlets.plan import InletPlan, InletsOutletsPlan
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.plan import Plan
from vgmpi.preprocess.initial_conditions import initial_velocity_gradient
from vgmpi.preprocess.scene_builder import PreparedScene, build_scene
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.restart.state_io import by_id
from vgmpi.solver.simulation import Simulation
from vgmpi.solver.step_to_target import next_step

ENERGIES = ("kinetic", "elastic", "potential")  # of the ledger

__all__ = ["advance", "begin", "by_id", "inlets_of", "mass_speed", "totals"]


def begin(
    folder: Path, text: str, ranks=None, velocity=None, threads: int = 1, engine: str = "cpu"
):
    """(Simulation, Prepared) of a scene's text. velocity: x (n, 3) -> v (n, 3) instead of the
    scene's.
    """
    ranks = ranks or SerialCommunicator()
    loaded = scene(folder, text)
    made = build_scene(loaded)
    plan = plan_for(loaded, known_of(loaded, made))
    simulation = Simulation(plan, ranks, made.colliders, threads, engine)
    n = len(made.x)
    mine = slice(n * ranks.rank // ranks.size, n * (ranks.rank + 1) // ranks.size)
    v = made.v0 if velocity is None else velocity(made.x)
    rows = (made.x, v, made.vol0, np.arange(n), made.object, made.theta0)
    C = initial_velocity_gradient(loaded, made.x, made.object) if velocity is None else None
    surface = None if made.surface0 is None else made.surface0[mine]
    simulation.put(
        *(row[mine] for row in rows), None if C is None else C[mine], made.sh[mine], surface
    )
    return simulation, made


def advance(simulation: Simulation, end: float) -> None:
    """Steps up to `end` [s]."""
    while simulation.time < end:
        goal = simulation.next_event_time(end)
        dt, lands = next_step(simulation.time, goal, simulation.bound())
        simulation.advance(dt, end=goal if lands else None)


def inlets_of(plan: Plan) -> tuple[InletPlan, ...]:
    """Inlets of a plan."""
    flows = plan.feature(InletsOutletsPlan)
    return flows.inlets if flows else ()


def totals(simulation: Simulation) -> dict[str, np.ndarray | float]:
    """Sums over all phases: mass, momentum (3,), angular (3,), energy."""
    rows = conservation_rows(simulation)
    return {
        "mass": sum(r["mass"] for r in rows),
        "momentum": sum(np.array([r[f"momentum_{a}"] for a in "xyz"]) for r in rows),
        "angular": sum(np.array([r[f"angular_momentum_{a}"] for a in "xyz"]) for r in rows),
        "energy": sum(r[f"{kind}_energy"] for r in rows for kind in ENERGIES),
        "kinetic": sum(r["kinetic_energy"] for r in rows),
    }


def mass_speed(simulation: Simulation, made: PreparedScene) -> float:
    """sum m |v| [kg m/s]."""
    (v,) = by_id(simulation, "v")
    density = np.array([thing["density"] or 0.0 for thing in made.objects])
    return float((density[made.object] * made.vol0 * np.sqrt((v**2).sum(1))).sum())
