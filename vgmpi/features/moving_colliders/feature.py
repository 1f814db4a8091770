"""Moving colliders: scenery that moves along a given course, and all that steps evaluate like it.

See docs/explanation/boundaries.md.
"""

from typing import Any

from vgmpi.scene.scene_feature import SceneFeature


class MovingColliders(SceneFeature):
    """Moving colliders in the tables of a scene."""

    name, title = "moving_colliders", "moving colliders"

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the colliders, or None without any, and the draft as it is.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        if not any(obj.collider for obj in draft.scene.object):
            return None, draft
        from .plan import MovingCollidersPlan

        return MovingCollidersPlan(), draft


FEATURE = MovingColliders()
