"""Particle shifting: liquids keep their volume although particles crowd and spread.

See `volume_correction` in docs/reference/scene.md and docs/explanation/transfer-schemes.md.
"""

from typing import Any

from vgmpi.scene.scene_feature import SceneFeature


class ParticleShifting(SceneFeature):
    """Particle shifting in the tables of a scene: a value of `accuracy.volume_correction`."""

    name, title = "shifting", "particle shifting"

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return its plan, or None, and the draft with the price of the shifts.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if draft.scene.accuracy.volume_correction != self.name:
            return None, draft
        from .plan import plan_shifting

        return plan_shifting(draft)


FEATURE = ParticleShifting()
