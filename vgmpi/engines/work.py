"""What the transfers of a group need, laid out for the tables in force."""

from typing import NamedTuple

import numpy as np

from ..domain.state import Group
from ..domain.topology import Topology
from ..kernels import beside, g2p
from ..kernels.given import Ghosts
from ..kernels.tables import Particles, Segments
from ..kernels.volume import Kept
from ..planning.groups import GroupPlan
from ..planning.plan import Plan
from .base import Beyond
from .layers import Contribution
from .shares import Shares


class GroupWork(NamedTuple):
    """A group as its transfers need it, laid out for the tables in force."""

    group: Group
    particles: Particles
    segments: Segments
    shares: Shares
    given: list[Contribution]
    moving: Contribution  # in a step of no time
    numbers: g2p.Numbers
    ghosts: Ghosts | None  # where somebody asks what walls give


def numbers_of(plan: Plan, group: GroupPlan) -> g2p.Numbers:
    found = (
        plan.splines, group.stiff, group.dense, group.slips, beside.RELAX,
        group.channels.first("share"), plan.dx,
    )  # fmt: skip
    return g2p.Numbers(*map(plan.real.type, found))


def particles_of(group: Group) -> Particles:
    return Particles(group.xi, group.f, group.ids)


def gathers(plan: Plan, group: GroupPlan, has: dict, dt: float) -> tuple:
    """What a group's particles gather besides the velocity in a step of dt [s]: a kind of
    kernels/beside.py. has: what nodes have of it, by name."""
    inner = _others(plan, group, has, dt)
    return Kept(inner, plan.real.type(group.space)) if group.space else inner


def _others(plan: Plan, group: GroupPlan, has: dict, dt: float) -> tuple:
    """The same without what holds its volume."""
    if not group.apart:
        return beside.Nothing(0.0)
    sharing = beside.Sharing(has["flux"], has["drift"], int(plan.drifts))
    if plan.keeps is None:
        return sharing
    patch = 1 + sharing.drifts if group.shares else 0
    blend = beside.Blend(has["change"], plan.real.type(plan.keeps.over(dt)), patch)
    return beside.Both(sharing, blend) if group.shares else blend


def lowest_beyond(here: np.ndarray, tables: Topology, layer: str) -> Beyond | None:
    """The lowest node block of a layer of which a sum left its range, None where none did.
    here: (threads,) the number of the block and 1, 0 for none."""
    if not here.any():
        return None
    nb = int(here[here > 0].min()) - 1
    block = int(np.searchsorted(tables.first, nb, side="right")) - 1
    i, j, k = (int(b) for b in tables.at[block])
    return Beyond((i, j, k), int(tables.phase[nb]), layer)
