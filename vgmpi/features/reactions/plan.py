"""Plan of reactions: what sums of impulses cost."""

from typing import Any

from vgmpi.planning.feature_plan import FeaturePlan
from vgmpi.planning.step_costs import ProximityCost, StageCost


class ReactionsPlan(FeaturePlan):
    """Reactions of a run."""

    name, title = "reactions", "probes of what colliders give"
    numbers_colliders = True
    collider_cost = ProximityCost(StageCost(0.0, 0.05), StageCost(0.0, 60.0))

    def start(self, context: Any) -> Any:
        """Return the reactions as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import Reactions  # it compiles

        return Reactions(context)
