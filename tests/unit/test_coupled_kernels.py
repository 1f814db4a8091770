"""The compiled solver agrees with the slow twin of the coupled step (tests/coupled_reference.py) to
rounding: two fluids that mix, sand and water, sand and two fluids; particles off their lattice.
"""

import numpy as np
import pytest

from tests.coupled_reference import CoupledReference
from tests.reference import Body
from tests.scenes import scene
from vgmpi.domain.ranks import Alone
from vgmpi.prepare.build import build
from vgmpi.solver.prepared import known_of, plan_for
from vgmpi.solver.step import Simulation

HEAD = """
[domain]
size = [0.2, 0.18, 0.16]
cell = 0.02
gravity = [0.5, -0.3, -9.8]
boundary = { BOUNDARY }
[time]
end = 1
"""
BODIES = {
    "water": (
        'kind = "fluid"\nbulk_modulus = 2e4\nviscosity = 0.5',
        "[[0, 0, 0], [0.11, 0.18, 0.1]]",
        "[0.5, 0.2, -0.3]",
    ),
    "oil": (
        'kind = "fluid"\nbulk_modulus = 1e4\ndensity = 800',
        "[[0.05, 0, 0.02], [0.2, 0.18, 0.12]]",
        "[-0.4, 0, -0.1]",
    ),
    "sand": (
        'kind = "sand"\nyoungs_modulus = 2e5\nporosity = 0.45',
        "[[0.03, 0.02, 0], [0.15, 0.18, 0.08]]",
        "[0.1, -0.6, 0]",
    ),
}
COUPLED = {
    frozenset(("water", "oil")): 'kind = "mixing"\ndiffusion = 2e-4\nslip_time = 3e-3',
    frozenset(("water", "sand")): 'kind = "drag"\npermeability = 2e-2',
    frozenset(("oil", "sand")): 'kind = "drag"\npermeability = 5e-3',
}
WALLS = {
    "slip": 'default = "slip"',
    "mixed": 'default = "slip", floor = "stick", west = { kind = "separate", friction = 0.2 }',
}


def beside(folder, names, walls):
    """(simulation, twin) of the same particles."""
    text = HEAD.replace("BOUNDARY", WALLS[walls])
    for name in names:
        keys, box, velocity = BODIES[name]
        text += f'[material.{name}]\n{keys}\n[[object]]\nname = "a {name}"\nmaterial = "{name}"\n'
        text += f"fraction = 0.6\nshape = {{ box = {box} }}\nvelocity = {velocity}\n"
    for pair, keys in COUPLED.items():
        if pair <= set(names):
            text += f"[[coupling]]\nbetween = {sorted(pair)}\n{keys}\n"
    loaded = scene(folder, text)
    made = build(loaded)
    plan = plan_for(loaded, known_of(loaded, made))
    random = np.random.default_rng(3)
    size = np.array(plan.cells) * plan.dx
    x = made.x + random.uniform(-0.2, 0.2, made.x.shape) * plan.dx
    x = np.clip(x, 0.01 * plan.dx, size - 0.01 * plan.dx)
    v = made.v0 + random.normal(0.0, 0.1, made.x.shape)
    simulation = Simulation(plan, Alone())
    simulation.put(x, v, made.vol0, np.arange(len(x)), made.object)
    bodies = []
    for g, group in enumerate(plan.groups):
        assert group.phase == g
        mine = np.array(plan.group_of)[made.object] == g
        n = int(mine.sum())
        law = type(group.law)(*(float(c) for c in group.law))
        rest = [np.full(n, c) for c in group.rest]
        C = np.zeros((n, 3, 3))
        bodies.append(Body(law, group.density, x[mine], v[mine], C, made.vol0[mine], rest))
    rules = plan.rules
    twin = CoupledReference(
        plan.cells, plan.dx, plan.gravity, plan.walls, bodies, rules.fluid,
        [group.share for group in plan.groups], rules.porosity, rules.drag,
        rules.diffusion.max(initial=0.0), rules.slip_time[0] if rules.mixes else np.inf,
    )  # fmt: skip
    return simulation, twin


def worst(simulation, twin):
    """Largest difference of each quantity, relative to its largest value; positions to a cell."""
    found = {}
    for k, (group, body) in enumerate(zip(simulation.groups, twin.bodies, strict=True)):
        at = group.index()
        order = np.argsort(group.ids[at])
        f = group.f[:, at][:, order]
        state = [*body.state, twin.pores[k]] if group.plan.porous else body.state
        compared = {
            "x": (group.positions()[order], body.x, twin.dx),
            "v": (f[0:3].T, body.v, np.abs(body.v).max()),
            "C": (f[3:12].T, body.C.reshape(-1, 9), np.abs(body.C).max()),
            "state": (f[13:], np.array(state), np.abs(np.array(state)).max()),
        }
        for name, (got, want, scale) in compared.items():
            found[f"{group.plan.name} {name}"] = float(np.abs(got - want).max() / scale)
    return found


@pytest.mark.parametrize("walls", WALLS)
@pytest.mark.parametrize(
    "names",
    [("water", "oil"), ("water", "sand"), ("water", "oil", "sand")],
    ids=["mixing", "drag", "both"],
)
def test_coupled_step(tmp_path, names, walls):
    simulation, twin = beside(tmp_path, names, walls)
    dt = 0.5 * simulation.bound()
    for step in range(12):
        if step == 6:
            simulation.sort()
        simulation.advance(dt)
        twin.step(dt)
        if step == 0:
            first = worst(simulation, twin)
    print(f"after a step {max(first.values()):.1e}, nodes with drag: {twin.dragged}")
    found = worst(simulation, twin)
    print({name: f"{value:.1e}" for name, value in found.items()})
    assert max(first.values()) < 1e-12 and max(found.values()) < 1e-12
    assert twin.dragged > 100 or "sand" not in names
