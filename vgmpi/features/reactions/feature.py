"""Reactions: forces of bodies on colliders, prescribed bodies and walls, for the probes of a scene.

They are sums of impulses that all kernels add to (kernels/reaction_impulses.py).
"""

from typing import Any

from vgmpi.scene.scene_feature import SceneFeature


class Reactions(SceneFeature):
    """Reactions in the tables of a scene: probes of a collider or of one wall."""

    name, title = "reactions", "probes of forces on a wall or collider"

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the reactions, or None if nothing measures them, and the draft.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not any(probe.measures_reaction for probe in draft.scene.probe):
            return None, draft
        from .plan import ReactionsPlan

        return ReactionsPlan(), draft


FEATURE = Reactions()
