"""Request for a nodal field: what particles add to it, where, and who reads it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vgmpi.parallel.exchange_topology import EVERYWHERE, FieldPlace
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan


class CarriedValues(NamedTuple):
    """Three values of particles that a step replaces by their mean around the particle.

    The mean at a node is weighted by the current volume, over all phases of a set.
    """

    set_of: np.ndarray  # (phases,) phases of one number share the mean; -1: none
    channel: Callable[[GroupPlan], int]  # first of the three particle channels


class FieldRequest(NamedTuple):
    """Nodal field besides momentum and offsets. Engines sum it as they sum momentum."""

    name: str
    accumulator_range: Callable[[float], np.ndarray]  # speed [m/s] -> largest sums, (phases, 4)
    kind: Callable[[GroupPlan], tuple | None]  # contribution of the particles of a group, if any
    region: str = EVERYWHERE  # see `exchange_topology.FieldPlace`
    is_timeless: bool = False  # a step of no time sums it, and no other step
    is_for_couplings: bool = False  # nothing but couplings reads it, after the grid update
    carried: CarriedValues | None = None  # particles take it back

    def place(self, plan: Plan) -> FieldPlace:
        """Return where it is summed."""
        groups = np.array([self.kind(group) is not None for group in plan.groups])
        return FieldPlace(self.name, groups, self.region, self.is_timeless)
