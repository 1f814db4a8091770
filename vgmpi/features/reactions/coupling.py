"""Reaction impulses of colliders, prescribed bodies and walls since the start of a run.

Each reaction holds an impulse, its moment and its work. It is accumulated in whole numbers, so
that it has the same bits on any number of ranks.
"""

import math
from typing import Any

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.io.checkpoint import Checkpoint, Mismatch, is_number
from vgmpi.kernels.reaction_impulses import NUMBERS, WALLS
from vgmpi.kernels.step_records import ParticleBounds, StepReport, StepSpan
from vgmpi.planning.feature_plan import first_reaction_rows
from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts

HEADROOM = 16.0  # [mass times cell per step] upper bound of the sum of impulses in one step
ACCUMULATOR_BITS = 62  # [bits] size of the integers that hold the sums


class Reactions(ActiveFeature):
    """Reactions of rigid boundaries on the deformable bodies.

    `totals` has the shape (rows, 7): impulse on the bodies [kg m/s], its moment about the row's
    reference point [kg m2/s], and work [J]. Rows: colliders in the order of the scene, bodies
    of features, then the walls west, east, south, north, floor, roof. The reference
    point of a moving collider or of a prescribed body is the current place of its center of
    rotation; that of a collider at rest is the middle of its extent, that of a wall its middle.
    `mass` [kg] bounds the mass of all deformable bodies.
    """

    def __init__(self, context: StartContext):
        """Set up one row per collider, prescribed body and wall."""
        plan, colliders = context.plan, context.colliders
        self.plan, self.ranks, self.groups = plan, context.ranks, context.groups
        self.movers, self.features, self.engine = context.movers, context.features, context.engine
        self.colliders = [collider.name for collider in colliders]
        self.moving = [m for m, collider in enumerate(colliders) if collider.course is not None]
        bodies = [body for feature in plan.features for body in feature.reaction_bodies()]
        self.objects_of_features = [objects for objects, _ in bodies]
        centers = [center for _, center in bodies]
        self.points = np.array([*map(_reference_point, colliders), *centers, *_wall_centers(plan)])
        self.first_rows = first_reaction_rows(plan.features, len(self.colliders))
        self.totals = np.zeros((len(self.points), NUMBERS))
        self.quanta = np.ones(NUMBERS)
        self.mass = 0.0
        self.engine.enable_reactions(len(self.totals), self.quanta, self.ranks.rank)

    def begin_run(self, bounds: ParticleBounds) -> ParticleBounds:
        """Set the upper bound of the bodies' mass, valid for the whole run."""
        groups = self.groups
        max_volume = np.zeros(len(groups))
        for g, group in enumerate(groups):
            max_volume[g] = group.get("vol0", group.index()).max(initial=0.0)
        max_volume = self.ranks.max(max_volume)
        if self.plan.has_sources:  # perhaps no particle of a source exists yet
            max_volume = np.maximum(max_volume, self.plan.dx**3)
        self.mass = sum(
            n * float(max_volume[g]) * self.plan.groups[g].density
            for n, g in group_counts(self.plan)
            if g >= 0
        )
        return bounds

    def begin_step(self, span: StepSpan) -> None:
        """Choose the quanta in which the sums of a step are counted.

        Nothing travels further than a cell per step, so the sums cannot leave their range.
        """
        plan = self.plan
        speed, arm = plan.dx / span.dt, 2.0 * plan.dx * (max(plan.cells) + 2)
        max_impulse = self.mass * speed * (HEADROOM + 4.0 * plan.correction_interval)
        quantum = _power_of_two_above(max_impulse) * 2.0**-ACCUMULATOR_BITS
        self.quanta[:3], self.quanta[3:6] = quantum, quantum * _power_of_two_above(arm)
        self.quanta[6] = quantum * _power_of_two_above(4.0 * speed)

    def row(self, name: str, number: int) -> int:
        """Return the row of a collider by name, or of another body by its number."""
        if name in self.colliders:
            return self.colliders.index(name)
        rows = [k for k, objects in enumerate(self.objects_of_features) if number in objects]
        return len(self.colliders) + rows[0]

    def end_step(self, span: StepSpan, report: StepReport) -> StepReport:
        """Add the reactions of one step."""
        reaction = self.ranks.sum(self.engine.take_reactions()) * self.quanta
        points = self.points.copy()
        for name, row in self.first_rows.items():
            if name in self.features:
                present = self.features[name].reaction_points()
                points[row : row + len(present)] = present
        if self.movers is not None:
            table = self.movers.table
            points[self.moving] = (table.about + table.move)[self.moving]
        (px, py, pz), (jx, jy, jz) = points.T, reaction[:, :3].T
        reaction[:, 3] -= py * jz - pz * jy
        reaction[:, 4] -= pz * jx - px * jz
        reaction[:, 5] -= px * jy - py * jx
        self.totals += reaction
        return report

    def saved(self) -> dict:
        """Return the reactions and the bound of the mass."""
        return {"given": {"mass": self.mass, "totals": self.totals.tolist()}}

    def restore(self, saved: Checkpoint) -> None:
        """Restore a saved state if it has the same number of rows.

        Args:
            saved: The checkpoint.

        Raises:
            Mismatch: The saved state is impossible.
        """
        self.begin_run(ParticleBounds())
        state: Any = saved.attrs.get("given", {"mass": 0.0, "totals": []})
        is_valid = (
            isinstance(state, dict)
            and is_number(state.get("mass"))
            and 0.0 <= state["mass"] < 1e100
        )
        rows: Any = state.get("totals") if is_valid else None
        is_valid = isinstance(rows, list)
        for row in rows if is_valid else []:
            is_valid = is_valid and isinstance(row, list) and len(row) == NUMBERS
            is_valid = is_valid and all(is_number(value) and abs(value) < 1e100 for value in row)
        if not is_valid:
            raise Mismatch(f"{saved.path}: attrs: given cannot be {state!r:.60}")
        totals = np.array(state["totals"], np.float64)
        if totals.shape == self.totals.shape:
            self.totals, self.mass = totals, float(state["mass"])


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
