"""Color transfer: colors of particles that mix through the grid in every step.

See `color_transfer` in docs/reference/scene.md; other values are of the renderer.
"""

from typing import Any

from vgmpi.scene.scene_feature import InitialParticles, SceneFeature


class ColorTransfer(SceneFeature):
    """Colors that travel with the steps, in the tables of a scene."""

    name, title = "color_transfer", "colors that travel"
    precedes_copies = True

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the ranges of the color coefficients by object, or None if no color travels.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        if scene.appearance.color_transfer != "step":
            return None
        from .plan import coefficient_ranges

        return coefficient_ranges(len(particles.entries), particles.owner, particles.sh)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the colors, or None if none travels, and the draft with their groups.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if draft.scene.appearance.color_transfer != "step":
            return None, draft
        from .plan import plan_colors

        return plan_colors(draft, prepared)


FEATURE = ColorTransfer()
