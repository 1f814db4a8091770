"""Plan of FLIP: how much of the unresolved motion particles retain."""

import math
from typing import Any, NamedTuple

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.step_costs import StageCost, StepCosts

CHANGE = "change"  # nodal change of velocity [m/s], for particles


class FlipBlend(NamedTuple):
    """FLIP blend: how much particles retain of the motion that the grid does not resolve."""

    share: float  # [-] fraction retained in each step
    damping: float  # [s] time after which the fraction 1 / e is left

    def over(self, dt: float) -> float:
        """Return the fraction that is retained in a step of dt [s]."""
        return self.share * math.exp(-dt / self.damping)


class FlipPlan(FeaturePlan):
    """FLIP or AFLIP of a run."""

    name = "flip"
    gathered = (CHANGE,)
    gathers_with_stress = separates_stress = True

    def __init__(self, blend: FlipBlend, transfer: str):
        """Take the blend and the name of the scheme."""
        self.blend, self.title = blend, f"{transfer} transfer"

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return what separate impulses and the blend cost per particle.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        return costs.separate_stress

    def retained_share(self, dt: float) -> float:
        """Return the share of unresolved motion that particles retain in a step of dt [s]."""
        return self.blend.over(dt)

    def gathers(self, group: GroupPlan) -> tuple[str, ...]:
        """Return what the particles of a group gather: the change of velocity."""
        return self.gathered if group.separates_stress else ()

    def gather_kind(self, group: GroupPlan, nodes: dict, dt: float, patch: int) -> Any:
        """Return the kind with which they gather it.

        Args:
            group, nodes, dt, patch: See `FeaturePlan.gather_kind`.
        """
        from .kernels import FlipGather

        share = type(group.law[0])(self.blend.over(dt))
        return FlipGather(nodes[CHANGE], share, patch)

    def node_stage(self, nodes: dict) -> Any:
        """Return the stage that stores the change of velocity.

        Args:
            nodes: See `FeaturePlan.node_stage`.
        """
        from .kernels import VelocityChange

        return VelocityChange(nodes[CHANGE])

    def dense_stage(self, plan: Any, dense: Any) -> Any:
        """Return the same for the reference engine.

        Args:
            plan, dense: See `FeaturePlan.dense_stage`.
        """
        from .kernels import DenseFlip

        return DenseFlip(self.blend, dense)


def plan_flip(draft: PlanDraft) -> tuple[FlipPlan, PlanDraft]:
    """Plan FLIP for all groups of a scene.

    Args:
        draft: Phases and groups.

    Returns:
        The plan, and the draft with groups whose stress impulses are summed separately.
    """
    accuracy = draft.scene.accuracy
    if accuracy.flip_ratio is not None:
        blend = FlipBlend(accuracy.flip_ratio, math.inf)
    else:
        blend = FlipBlend(1.0, accuracy.flip_decay_time)
    groups = tuple(group._replace(separates_stress=True) for group in draft.groups)
    return FlipPlan(blend, accuracy.transfer), draft._replace(groups=groups)
