"""Plan of moving colliders."""

from typing import Any

from vgmpi.planning.feature_plan import FeaturePlan


class MovingCollidersPlan(FeaturePlan):
    """Colliders of a run, of which some may move."""

    name, joins_compilation = "moving_colliders", False

    def start(self, context: Any) -> Any:
        """Return the colliders as they act in a run, or None if none is evaluated in its steps.

        Args:
            context: See `FeaturePlan.start`.
        """
        if context.movers is None:
            return None
        from .coupling import ColliderMotion  # it compiles

        return ColliderMotion(context)
