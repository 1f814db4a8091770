"""Free rigid bodies with joints: bodies of solids that do not deform and have no particles.

See docs/explanation/rigid-bodies.md.
"""

import logging
from dataclasses import replace
from typing import Any

import numpy as np

from vgmpi.scene.scene_feature import (
    Errors,
    InitialParticles,
    SceneFeature,
    SceneTables,
    TableList,
)

from .table import JOINTS, HingeMotor, SliderMotor, validate_joint_probes, validate_joints

log = logging.getLogger("vgmpi")
MAX_BODY_LENGTH = 4.0  # [-] of a body over the longest edge of the domain


class RigidBodies(SceneFeature):
    """Free rigid bodies in the tables of a scene."""

    name, title = "rigid_bodies", "free rigid bodies"
    lists = {
        "joint": TableList(
            JOINTS, {"motor of a hinge": HingeMotor, "motor of a slider": SliderMotor}
        )
    }

    missing_engines, suits_implicit_pressure = ("cuda",), True

    def named_parts(self, scene: Any) -> list[tuple[str, tuple]]:
        """Return joints and bodies.

        Args:
            scene: See `SceneFeature.named_parts`.
        """
        joints = [("joints", ("joint", k)) for k in range(len(scene.lists["joint"]))]
        bodies = [
            (self.title, ("object", k, "rigid")) for k, obj in enumerate(scene.object) if obj.rigid
        ]
        return joints[:1] + bodies[:1]

    def check_list(self, name: str, raw: list[dict], tables: SceneTables) -> Errors:
        """Return the errors of the joints.

        Args:
            name, raw, tables: See `SceneFeature.check_list`.
        """
        return validate_joints(tables)

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes that name no joint.

        Args:
            probes, tables: See `SceneFeature.check_probes`.
        """
        return validate_joint_probes(probes, tables.lists["joint"])

    def check_size(self, obj: Any, length: float, size: tuple[float, ...]) -> Errors:
        """Return why a body is too large: it is searched as a whole.

        Args:
            obj, length, size: See `SceneFeature.check_size`.
        """
        limit = MAX_BODY_LENGTH * max(size)
        if obj.free_body is None or length <= limit:
            return []
        message = f"is {length:.4g} m long; at most {limit:.4g} m are possible in this domain"
        return [(("rigid",), message)]

    def complete_collider(
        self, obj: Any, collider: Any, dx: float, size: tuple[float, float, float]
    ) -> Any:
        """Return the collider of a body with its mass and its velocity.

        Args:
            obj, collider, dx, size: See `SceneFeature.complete_collider`.
        """
        if obj.free_body is None:
            return collider
        from .free_bodies import RigidBody, mass_properties  # it compiles

        masses = mass_properties(collider, obj.free_body.density, dx)
        return replace(collider, body=RigidBody(*masses, *obj.free_body[1:]))

    def check_collider(self, scene: Any, collider: Any) -> Errors:
        """Return why a body holds no volume, or is outside of the domain.

        Args:
            scene, collider: See `SceneFeature.check_collider`.
        """
        body = collider.body
        if body is None:
            return []
        if not body.mass > 0.0:
            return [(("rigid",), "the body encloses no volume")]
        if (body.center < 0.0).any() or (body.center > np.array(scene.domain.size)).any():
            return [((), "the center of mass is outside the domain")]
        return []

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the bodies as they are at the start, or None without any.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        if all(collider.body is None for collider in colliders):
            return None
        _warn_of_distant_joints(scene, colliders)
        from .surface_points import measure_rigid_bodies  # it compiles

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
        return RigidBodiesPlan(density, draft.scene.lists["joint"], prepared), draft


def _warn_of_distant_joints(scene: Any, colliders: list) -> None:
    """Warn of joints whose points are farther from their bodies than these are large.

    Args:
        scene: The scene.
        colliders: Its colliders, among them the bodies.
    """
    by_name = {collider.name: collider for collider in colliders}
    for k, joint in enumerate(scene.lists["joint"]):
        bodies = [by_name[name] for name in joint.between if name in by_name]
        bodies = [body for body in bodies if body.body is not None]
        gaps = [float(body.distance(np.array([joint.at]))[0]) for body in bodies]
        sizes = [float(np.subtract(*body.ends()[::-1]).max()) for body in bodies]
        if gaps and min(gap - size for gap, size in zip(gaps, sizes, strict=True)) > 0.0:
            log.warning(
                "joint %s is %.3g m from the nearest of its bodies, farther than their size",
                repr(joint.name) if joint.name else k, min(gaps),
            )  # fmt: skip


FEATURE = RigidBodies()
