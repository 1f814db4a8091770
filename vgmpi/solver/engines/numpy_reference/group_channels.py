"""Channels of a group's particles as doubles, for the reference engine."""

from typing import Any

import numpy as np

from vgmpi.materials.material import law_function
from vgmpi.parallel.particle_group import ParticleGroup


def get_channel(group: ParticleGroup, name: str) -> np.ndarray:
    """Return a channel of all particles, shape (n, width)."""
    return group.get(name, group.index()).astype(np.float64)


def put_channel(group: ParticleGroup, name: str, values: np.ndarray) -> None:
    """Set a channel of all particles, shape (n, width)."""
    group.put(name, group.index(), values)


def law_state(group: ParticleGroup) -> tuple[np.ndarray, ...]:
    """Return the state that the law of the group reads, a row per number."""
    return tuple(row.astype(np.float64) for row in group.law_state(group.index()))


def put_law_state(group: ParticleGroup, state: tuple) -> None:
    """Set the state that the law of the group has updated."""
    first = 0
    for name, values in group.plan.state:
        rows = [np.broadcast_to(s, len(group)) for s in state[first : first + len(values)]]
        put_channel(group, name, np.stack(rows, 1))
        first += len(values)


def law_in_doubles(group: ParticleGroup) -> tuple:
    """Return the numbers of the group's law in double precision."""
    law: Any = group.plan.law
    return law._make(float(c) for c in law)


def kirchhoff_stress(law, state: tuple, C: np.ndarray) -> np.ndarray:
    """Return the Kirchhoff stress, shape (n, 3, 3) [Pa]."""
    components = law_function(law, "stress")(law, state, tuple(C.T))
    xx, yy, zz, xy, xz, yz = (np.broadcast_to(c, len(C)) for c in components)
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
