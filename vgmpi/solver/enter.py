"""Particles given to a rank: from rows in SI units into the channels of their groups."""

from typing import NamedTuple

import numpy as np

from ..device.limits import FARTHEST, STRETCH
from ..domain import migrate
from ..domain.blocks import Lattice
from ..domain.state import Group
from ..materials.base import function
from ..planning.groups import GroupPlan
from ..planning.plan import Plan


class Rows(NamedTuple):
    """Particles: positions x (n, 3) [m], velocities v (n, 3) [m/s], rest volumes (n,) [m3], ids
    (n,), thing (n,) the object or source of each; theta (n,), C (n, 9) [1/s], sh (n, K, 3) and
    surface (n, 10) as of Simulation.put."""

    x: np.ndarray
    v: np.ndarray
    volume: np.ndarray
    ids: np.ndarray
    thing: np.ndarray
    theta: np.ndarray | None = None
    C: np.ndarray | None = None
    sh: np.ndarray | None = None
    surface: np.ndarray | None = None

    def only(self, there: np.ndarray) -> "Rows":
        """Those of which `there` (n,) is true."""
        parts: list = [None if rows is None else rows[there] for rows in self]
        return Rows(*parts)


def enter(plan: Plan, lattice: Lattice, groups: list[Group], rows: Rows) -> np.ndarray:
    """Give particles to the groups of this rank, besides those that these have; a sort must follow.
    Returns what bounds time steps and sums, as of `bounds`."""
    group_of = np.array(plan.group_of)[rows.thing] if len(rows.thing) else rows.thing
    least = np.zeros(4)
    for g, group in enumerate(groups):
        mine = rows.only(group_of == g)
        block, xi = lattice.place(mine.x, plan.real)
        f, states = _channels(plan, group.plan, mine, len(xi[0]))
        if len(mine.x):
            turns = mine.C if mine.C is not None else np.zeros((1, 9))
            least = np.maximum(least, bounds(plan, group.plan, states, mine.v, turns))
        migrate.arrive(group, block, xi, f, mine.ids)
    return least


def _channels(plan: Plan, group: GroupPlan, rows: Rows, count: int) -> tuple[np.ndarray, list]:
    """Numbers of the particles, (channels, count), and the states that bound theirs."""
    channels = group.channels
    f = np.repeat(np.array(channels.rest, plan.real)[:, None], count, axis=1)
    f[channels["v"].rows] = rows.v.T
    if rows.C is not None:
        f[channels["C"].rows] = rows.C.T
    f[channels["vol0"].rows] = rows.volume
    if group.surface and rows.surface is not None:
        f[channels["surface"].rows] = rows.surface.T
    hues = group.coefficients
    if hues and rows.sh is not None and plan.colours is not None:
        shown = rows.sh[:, :hues] - plan.colours.least[group.phase, :hues]
        f[channels["colour"].rows] = shown.reshape(len(shown), 3 * hues).T
    states = [group.rest]
    if rows.theta is not None and group.family == "fluid":
        f[channels["theta"].rows] = rows.theta
        # the fastest wave is at an end of the range, which the ranks agree on bit by bit
        states += [(end, *group.rest[1:]) for end in _ends(rows.theta)]
    return f, states


def bounds(plan: Plan, group: GroupPlan, states: list, v: np.ndarray, C: np.ndarray) -> np.ndarray:
    """(rate, speed, turn, stress) of particles of a group that begin in one of the states, as
    of engines.base.Reach. v: (n, 3) [m/s]; C: (n, 9) [1/s]."""
    law, dx, cfl = group.law, plan.dx, plan.cfl
    wave2 = group.bound(max(function(law, "wave_speed2")(law, state) for state in states))
    tau = [np.abs(function(law, "stress")(law, state, (0.0,) * 9)).sum() for state in states]
    speed, wave = float(np.sqrt((v**2).sum(1)).max()), float(np.sqrt(wave2))
    rate = max((wave + speed) / (cfl * dx), speed / (FARTHEST * dx))
    rate = max(rate, float(np.abs(C[:, 0] + C[:, 4] + C[:, 8]).max()) / STRETCH)
    stress = float(max(tau)) / (group.density * group.pores)
    return np.array([rate, speed, float(np.sqrt((C**2).sum(1)).max()), stress])


def idle(plan: Plan) -> np.ndarray:
    """The same where there is no particle at all: of one of the first group at rest, which moves as
    fast as its waves."""
    group = plan.groups[0]
    wave2 = float(function(group.law, "wave_speed2")(group.law, group.rest))
    v = np.array([[np.sqrt(group.bound(wave2)), 0.0, 0.0]])
    return bounds(plan, group, [group.rest], v, np.zeros((1, 9)))


def _ends(values: np.ndarray) -> list[float]:
    """Smallest and largest of (n,) values; nothing of none."""
    return [float(values.min()), float(values.max())] if len(values) else []
