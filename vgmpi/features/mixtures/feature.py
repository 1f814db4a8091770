"""Mixtures: phases that share space, fluids that mix and sands with fluids in their pores.

The tables [[coupling]] of kinds mixing and drag ask for them (materials/couplings); see
docs/explanation/mixtures.md.
"""

from typing import Any

from vgmpi.scene.scene_feature import SceneFeature


class Mixtures(SceneFeature):
    """Phases that share space, in the tables of a scene."""

    name = title = "mixtures"
    precedes_copies = True

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of phases that share space, or None, and the draft with their groups.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        from .plan import plan_mixtures

        return plan_mixtures(draft)


FEATURE = Mixtures()
