"""Of a body in a simulation: where its middle is, how fast that goes, and how fast it turns."""

import numpy as np

from vgmpi.solver.state import by_id

PLANES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}


def middle(simulation, made, name) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass (3,) [m] of the body of that name, and its velocity (3,) [m/s]."""
    x, v, volume = _of(simulation, made, name, "x", "v", "vol0")
    share = volume[:, None] / volume.sum()
    return (share * x).sum(axis=0), (share * v).sum(axis=0)


def spin(simulation, made, name, axis) -> float:
    """Angular momentum over moment of inertia [rad/s] about an axis through its centre."""
    momentum, inertia = angular(simulation, made, name, axis)
    return momentum / inertia


def angular(simulation, made, name, axis) -> tuple[float, float]:
    """Angular momentum [rad m5/s] and moment of inertia [m5] over density about an axis through its
    centre, with what the particles themselves turn by (APIC: C at a quarter of a cell squared)."""
    x, v, C, m = _of(simulation, made, name, "x", "v", "C", "vol0")
    at, u = middle(simulation, made, name)
    a, b = PLANES[axis]
    r, w, C, own = x - at, v - u, C.reshape(-1, 3, 3), simulation.plan.dx**2 / 4
    momentum = r[:, a] * w[:, b] - r[:, b] * w[:, a] + own * (C[:, b, a] - C[:, a, b])
    return float((m * momentum).sum()), float((m * (r[:, a] ** 2 + r[:, b] ** 2 + 2 * own)).sum())


def _of(simulation, made, name, *fields) -> list[np.ndarray]:
    mine = made.object == [thing["name"] for thing in made.objects].index(name)
    return [field[mine] for field in by_id(simulation, *fields)]
