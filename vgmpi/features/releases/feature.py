"""Releases: bodies, parts of them and walls that let go at a time.

See docs/explanation/boundaries.md.
"""

from typing import Any

from vgmpi.scene.scene_feature import SceneFeature


class Releases(SceneFeature):
    """Releases in the tables of a scene: other features say what particles are released."""

    name, title = "releases", "releases"

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the releases, or None without any, and the draft as it is.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        times = tuple(draft.scene.domain.wall_opening_times)
        particles = [each for plan in draft.features for each in plan.released_particles()]
        if not particles and all(time is None for time in times):
            return None, draft
        from .plan import ReleasesPlan

        return ReleasesPlan(times, tuple(particles)), draft


FEATURE = Releases()
