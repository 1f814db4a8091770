"""Plan of particle shifting: how often, which fields, and what it costs."""

from typing import Any

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan, correction_interval
from vgmpi.planning.step_costs import StageCost, StepCosts
from vgmpi.scene.scene import Scene

# Longest interval [steps] between two shifts, and longest travel of a wave in it [cells], as of the
# transfer correction. They have a part of its sweep in common.
MAX_SHIFT_INTERVAL, MAX_SHIFT_TRAVEL_CELLS = 6, 2.41


class ShiftingPlan(FeaturePlan):
    """Particle shifting of a run: all particles of liquids are shifted.

    Attributes:
        mixed_phases: Phases whose liquids differ in density: volumes tell how full cells are.
    """

    name, title = "shifting", "particle shifting"

    def __init__(self, interval: int, mixed_phases: frozenset[int], is_alone: bool):
        """Take how it acts.

        Args:
            interval: Number of steps between two shifts.
            mixed_phases: See the class.
            is_alone: Whether no transfer correction makes the steps of no time anyway.
        """
        self.correction_interval, self.is_alone = interval, is_alone
        self.mixed_phases, self.summed_fields = mixed_phases, int(bool(mixed_phases))

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return what shifts cost per particle of a liquid.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        if not group.is_liquid:
            return None
        cost = costs.fullness
        if group.phase in self.mixed_phases:
            cost += costs.rest_volume
        if self.is_alone:
            cost += costs.correction
        return cost * (1.0 / self.correction_interval)

    def field_requests(self, plan: Plan) -> tuple:
        """Return the request for rest volumes, where masses do not tell how full a cell is."""
        if not self.mixed_phases:
            return ()
        from .coupling import request_rest_volume  # it compiles

        return (request_rest_volume(plan, self.mixed_phases),)

    def start(self, context: Any) -> Any:
        """Return the shifts as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import ParticleShifting  # it compiles

        return ParticleShifting(self, context)


def plan_shifting(draft: PlanDraft) -> tuple[ShiftingPlan | None, PlanDraft]:
    """Plan the shifts of a scene.

    Args:
        draft: Phases and groups.

    Returns:
        The plan, None without liquids, and the draft as it is.
    """
    scene, liquids = draft.scene, [group for group in draft.groups if group.is_liquid]
    if not liquids:
        return None, draft
    mixed = frozenset(
        group.phase
        for group in liquids
        if draft.phases[group.phase].min_cell_mass < draft.phases[group.phase].max_cell_mass
    )
    is_alone = not scene.accuracy.corrects_transfers
    return ShiftingPlan(shift_interval(scene), mixed, is_alone), draft


def shift_interval(scene: Scene) -> int:
    """Return the number of steps between two shifts: whole intervals of the transfer correction."""
    interval = max(1, correction_interval(scene))
    travel = int(MAX_SHIFT_TRAVEL_CELLS / scene.courant_number)
    return interval * max(1, min(MAX_SHIFT_INTERVAL, travel) // interval)
