"""Two engines side by side, on the same particles: the compiled one and the one in plain numpy."""

import numpy as np

from tests.support.small_scenes import scene
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.preprocess.initial_conditions import initial_velocity_gradient
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.simulation import Simulation

# relative to the largest value there is
TOLERANCE = {"double": 1e-12, "single": 1e-5}
STRAIN_FLOOR = 1e-4  # [-] a strain B is exact to the rounding of B + I, as of grains in free flight


def beside(plan, colliders, x, v, volume, thing, engines=("cpu", "numpy"), **more):
    """Simulations of these particles, one per engine.

    x: (n, 3) [m]; v: (n, 3) [m/s]; volume: (n,) [m3]; thing: (n,) object of each; more: as of
    Simulation.put.
    """
    found = [Simulation(plan, SerialCommunicator(), colliders, engine=engine) for engine in engines]
    for one in found:
        one.put(x, v, volume, np.arange(len(x)), thing, **more)
    return found


def of_scene(folder, text, engines):
    """Simulations of a scene's text, one per engine, on the same particles off their lattice."""
    loaded = scene(folder, text)
    made = build_scene(loaded)
    plan = plan_for(loaded, known_of(loaded, made))
    x, v = shaken(made, plan, 3)
    C = initial_velocity_gradient(loaded, x, made.object)
    more = {"theta": made.theta0, "C": C, "sh": made.sh, "surface": made.surface0}
    return beside(plan, made.colliders, x, v, made.vol0, made.object, engines, **more)


def shaken(made, plan, seed):
    """(x, v) of what build_scene made, moved off its lattice at random: no sum cancels by
    symmetry, no contact hangs on a rounding error."""
    random, size = np.random.default_rng(seed), np.array(plan.cells) * plan.dx
    x = made.x + random.uniform(-0.2, 0.2, made.x.shape) * plan.dx
    x = np.clip(x, 0.01 * plan.dx, size - 0.01 * plan.dx)
    return x, made.v0 + random.normal(0.0, 0.1, made.x.shape)


def worst(one, other):
    """Largest difference of each quantity, relative to its largest value; positions to a cell."""
    found = {}
    for a, b in zip(one.groups, other.groups, strict=True):
        at, there = (g.index()[np.argsort(g.ids[g.index()])] for g in (a, b))
        place = [g.positions()[np.argsort(g.ids[g.index()])] for g in (a, b)]
        apart = np.abs(place[0] - place[1]).max(initial=0.0)
        found[f"{a.plan.name} x"] = float(apart / one.plan.dx)
        for channel in a.plan.channels:
            got, want = a.get(channel.name, at), b.get(channel.name, there).astype(np.float64)
            least = STRAIN_FLOOR if channel.name == "B" else 1e-30
            scale = max(np.abs(want).max(initial=0.0), least)
            difference = np.abs(got - want).max(initial=0.0)
            found[f"{a.plan.name} {channel.name}"] = float(difference / scale)
    return found
