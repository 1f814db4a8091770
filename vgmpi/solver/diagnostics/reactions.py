"""Reaction impulses of colliders, prescribed bodies and walls since the start of a run.

Each reaction holds an impulse, its moment and its work. It is accumulated in whole numbers, so
that it has the same bits on any number of ranks.
"""

import math
from collections.abc import Sequence

import numpy as np

from vgmpi.kernels.reaction_impulses import NUMBERS, WALLS
from vgmpi.kernels.rigid.moving_colliders import MovingColliders
from vgmpi.kernels.rigid.prescribed_motion import PrescribedBodies
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts

HEADROOM = 16.0  # [mass times cell per step] upper bound of the sum of impulses in one step
ACCUMULATOR_BITS = 62  # [bits] size of the integers that hold the sums


class Reactions:
    """Reactions of rigid boundaries on the deformable bodies.

    `totals` has the shape (rows, 7): impulse on the bodies [kg m/s], its moment about the row's
    reference point [kg m2/s], and work [J]. Rows: colliders in the order of the scene, prescribed
    bodies, then the walls west, east, south, north, floor, roof. The reference point of a moving
    collider or of a prescribed body is the current place of its center of rotation; that of a
    collider at rest is the middle of its extent, that of a wall its middle. `mass` [kg] bounds
    the mass of all deformable bodies.
    """

    def __init__(self, plan: Plan, colliders: Sequence, ranks: SerialCommunicator):
        """Set up one row per collider, prescribed body and wall."""
        self.plan, self.ranks = plan, ranks
        self.colliders = [collider.name for collider in colliders]
        self.moving = [m for m, collider in enumerate(colliders) if collider.course is not None]
        driven = [body.about for body in plan.driven]
        self.points = np.array([*map(_reference_point, colliders), *driven, *_wall_centers(plan)])
        self.totals = np.zeros((len(self.points), NUMBERS))
        self.quanta = np.ones(NUMBERS)
        self.mass = 0.0

    def set_mass_bound(self, groups: list[ParticleGroup]) -> None:
        """Set the upper bound of the bodies' mass, valid for the whole run. Collective."""
        max_volume = np.zeros(len(groups))
        for g, group in enumerate(groups):
            max_volume[g] = group.get("vol0", group.index()).max(initial=0.0)
        max_volume = self.ranks.max(max_volume)
        if self.plan.sources:  # perhaps no inlet particle exists yet
            max_volume = np.maximum(max_volume, self.plan.dx**3)
        self.mass = sum(
            n * float(max_volume[g]) * self.plan.groups[g].density
            for n, g in group_counts(self.plan)
            if g >= 0
        )

    def begin(self, dt: float) -> None:
        """Choose the quanta in which the sums of a step of dt [s] are counted.

        Nothing travels further than a cell per step, so the sums cannot leave their range.
        """
        plan = self.plan
        speed, arm = plan.dx / dt, 2.0 * plan.dx * (max(plan.cells) + 2)
        max_impulse = self.mass * speed * (HEADROOM + 4.0 * plan.restores)
        quantum = _power_of_two_above(max_impulse) * 2.0**-ACCUMULATOR_BITS
        self.quanta[:3], self.quanta[3:6] = quantum, quantum * _power_of_two_above(arm)
        self.quanta[6] = quantum * _power_of_two_above(4.0 * speed)

    def row(self, name: str, number: int) -> int:
        """Return the row of a collider by name, or of a prescribed body by object number."""
        if name in self.colliders:
            return self.colliders.index(name)
        rows = [k for k, body in enumerate(self.plan.driven) if number in body.things]
        return len(self.colliders) + rows[0]

    def add_step(
        self, counted: np.ndarray, movers: MovingColliders | None, driven: PrescribedBodies | None
    ) -> None:
        """Add the reactions of one step. Collective.

        Args:
            counted: Reactions on this rank in quanta, shape (rows, 7) int64.
            movers: Moving colliders, or None.
            driven: Prescribed bodies, or None.
        """
        reaction = self.ranks.sum(counted) * self.quanta
        points = self.points.copy()
        if driven is not None:
            phases = [self.plan.groups[body.group].phase for body in self.plan.driven]
            points[driven.ways.row[phases]] = driven.ways.about[phases]
        if movers is not None:
            table = movers.table
            points[self.moving] = (table.about + table.move)[self.moving]
        (px, py, pz), (jx, jy, jz) = points.T, reaction[:, :3].T
        reaction[:, 3] -= py * jz - pz * jy
        reaction[:, 4] -= pz * jx - px * jz
        reaction[:, 5] -= px * jy - py * jx
        self.totals += reaction

    def saved(self) -> dict:
        """Return the state that a checkpoint stores."""
        return {"mass": self.mass, "totals": self.totals.tolist()}

    def restore(self, saved: dict) -> None:
        """Restore a saved state if it has the same number of rows."""
        totals = np.array(saved["totals"], np.float64)
        if totals.shape == self.totals.shape:
            self.totals, self.mass = totals, float(saved["mass"])


def _power_of_two_above(value: float) -> float:
    """Return the least power of two that is not below a number; 1 if that is not positive."""
    return 2.0 ** math.ceil(math.log2(value)) if value > 0.0 else 1.0


def _reference_point(collider) -> tuple[float, float, float]:
    """Return the center of rotation [m] of a moving collider, or the middle of one at rest."""
    if collider.course is not None:
        return tuple(collider.course.about)
    low, high = collider.ends()
    return tuple(0.5 * (low + high))


def _wall_centers(plan: Plan) -> list[tuple[float, float, float]]:
    """Return the middle of each wall [m]."""
    size = np.array(plan.cells) * plan.dx
    middles = []
    for wall in range(WALLS):
        middle = 0.5 * size
        middle[wall // 2] = wall % 2 * size[wall // 2]
        middles.append(tuple(middle))
    return middles
