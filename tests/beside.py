"""The compiled solver and the slow reference side by side, on the same particles."""

import numpy as np

from tests.reference import Body, Reference
from vgmpi.domain.ranks import Alone
from vgmpi.solver.step import Simulation

# relative to the largest value there is
TOLERANCE = {"double": 1e-12, "single": 1e-5}


def beside(plan, colliders, x, v, volume, thing):
    """(simulation, reference) of these particles; the reference has a body per phase.

    x: (n, 3) [m]; v: (n, 3) [m/s]; volume: (n,) [m3]; thing: (n,) object of each.
    """
    simulation = Simulation(plan, Alone(), colliders)
    simulation.put(x, v, volume, np.arange(len(x)), thing)
    bodies = []
    for g, group in enumerate(plan.groups):
        mine = np.array(plan.group_of)[thing] == g
        assert group.phase == g, "the reference has one body per phase"
        n = int(mine.sum())
        law = type(group.law)(*(float(c) for c in group.law))
        rest = [np.full(n, c) for c in group.rest]
        bodies.append(
            Body(law, group.density, x[mine], v[mine], np.zeros((n, 3, 3)), volume[mine], rest)
        )
    master = int(np.argmin([phase.mastery for phase in plan.phases]))
    friction = plan.friction[0][1] if len(plan.phases) == 2 else plan.friction[1][0]
    collider = colliders[0] if colliders else None
    reference = Reference(
        plan.cells, plan.dx, plan.gravity, plan.walls, bodies, friction, master, collider
    )
    return simulation, reference


def worst(simulation, reference):
    """Largest difference of each quantity, relative to its largest value; positions to a cell."""
    found = {}
    for group, body in zip(simulation.groups, reference.bodies, strict=True):
        at = group.index()
        order = np.argsort(group.ids[at])
        f = group.f[:, at][:, order].astype(np.float64)
        compared = {
            "x": (group.positions()[order], body.x, reference.dx),
            "v": (f[0:3].T, body.v, np.abs(body.v).max()),
            "C": (f[3:12].T, body.C.reshape(-1, 9), np.abs(body.C).max()),
            "state": (
                f[13 : 13 + len(body.state)],
                np.array(body.state),
                np.abs(np.array(body.state)).max(),
            ),
        }
        for name, (got, want, scale) in compared.items():
            found[f"{group.plan.name} {name}"] = float(np.abs(got - want).max() / scale)
    return found
