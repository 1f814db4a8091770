"""The layers a scene needs, their sums and values at the nodes of a rank, and what the particles of
a group give to each.
"""

from typing import NamedTuple

import numpy as np

from ..device.memory import aligned, grown
from ..domain.topology import hue
from ..kernels import sums
from ..kernels.layers import colour, impulses, momentum, offsets, shear
from ..kernels.tables import Sums
from ..planning.groups import GroupPlan
from ..planning.plan import Plan


class Contribution(NamedTuple):
    """What some segments of a group give to a layer."""

    layer: str
    kind: tuple  # kernels.layers
    chosen: np.ndarray  # (segments,) bool


class Layer:
    """The sums and values of a layer at the nodes of this rank."""

    def __init__(self, name: str, full, plan: Plan):
        """full(speed) -> (phases, 4): how large a sum may become, see kernels/sums.py."""
        self.name, self.full, self.real = name, full, plan.real
        self.sums = aligned((0, sums.words(plan.real), sums.BLOCK), np.float64)
        self.nodes = aligned((0, sums.BLOCK), plan.real)
        self.asked = np.zeros(0, np.uint8)
        self.speed = 0.0  # that the quanta are for; 0: the sums are not at rest
        self.sized = np.zeros(0)  # `full` of it
        self.rest = np.zeros((len(plan.phases), sums.words(plan.real), 16))
        self.tables = Sums(self.sums, self.rest, self.asked, self.nodes)

    def adopt(self, asked: np.ndarray, phase_of_row: np.ndarray) -> None:
        """Make room for node blocks (n,), and for the copies of some behind them."""
        needed = len(phase_of_row) if asked.any() else 0
        self.asked, self.phase = asked.astype(np.uint8), phase_of_row[:needed]
        self.sums = grown(self.sums, needed)
        self.nodes = grown(self.nodes, len(asked) if needed else 0)
        self.nodes[:] = 0
        self.speed, self.sized = 0.0, np.zeros(0)

    def begin(self, speed: float) -> None:
        """Choose the quanta; sums that rest elsewhere are put to rest. speed: a power of 8 [m/s]
        that is not below base.Reach."""
        if speed == self.speed:
            return
        self.speed, full = speed, self.full(speed)
        if not np.array_equal(full, self.sized):
            self.sized, self.rest = full, sums.rests(full, self.real)
            sums.reset(self.sums, self.rest, np.arange(len(self.phase)), self.phase)
            self.tables = Sums(self.sums, self.rest, self.asked, self.nodes)


def hues(plan: Plan) -> int:
    """Coefficients of colour that travel with the steps, of the group with most."""
    return max((group.coefficients for group in plan.groups), default=0)


def layers(plan: Plan, apart: bool, made=Layer) -> list[Layer]:
    """The layers a scene needs, in the order in which grid kernels report of them; of volumes and
    offsets nothing exists where nothing may touch. made: their class."""
    found = [
        made("momentum", lambda speed: momentum.full(plan, speed), plan),
        made("offsets", lambda _: offsets.full(plan), plan),
    ]
    if apart:
        found.append(made("impulses", lambda speed: impulses.full(plan, speed), plan))
    if plan.rubs:
        found.append(made("shear", lambda speed: momentum.full(plan, speed), plan))
    for k in range(hues(plan)):
        found.append(made(hue(k), lambda _, k=k: colour.full(plan, k), plan))
    return found


def contributions(plan: Plan, group: GroupPlan, takes: dict, split) -> list[Contribution]:
    """What a group's segments give to each layer."""
    whole, inert = momentum.kinds(plan, group)
    found = [
        Contribution("momentum", inert, split | True)  # no stress moves what is driven
        if group.driven
        else Contribution("momentum", whole, ~split),
        Contribution("offsets", offsets.kind(plan, group), takes["offsets"]),
    ]
    if group.apart:
        found.append(Contribution("momentum", inert, split))
        found.append(Contribution("impulses", impulses.kind(plan, group), split))
    if plan.rubs and group.surface:
        found.append(Contribution("shear", shear.kind(plan, group), takes["shear"]))
    for k in range(group.coefficients):
        found.append(Contribution(hue(k), colour.kind(plan, group, k), takes[hue(k)]))
    return [given for given in found if given.chosen.any()]
