"""Free rigid bodies with joints: bodies of solids that do not deform and have no particles.

See docs/explanation/rigid-bodies.md.
"""

from typing import Any

from vgmpi.scene.scene_feature import InitialParticles, SceneFeature


class RigidBodies(SceneFeature):
    """Free rigid bodies in the tables of a scene."""

    name, title = "rigid_bodies", "free rigid bodies"

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the bodies as they are at the start, or None without any.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        if all(collider.body is None for collider in colliders):
            return None
        from .measurement import measure_rigid_bodies  # it compiles

        return measure_rigid_bodies(colliders, scene.domain.cell)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the bodies and the draft, which they do not change.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        bodies = {obj.name: obj.free_body for obj in draft.scene.object if obj.free_body}
        if not bodies:
            return None, draft
        from .plan import RigidBodiesPlan

        density = {name: body.density for name, body in bodies.items()}
        return RigidBodiesPlan(density, draft.scene.joint, prepared), draft


FEATURE = RigidBodies()
