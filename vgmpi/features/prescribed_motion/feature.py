"""Prescribed motion: bodies that move along a given course, or stay fixed, until they are released.

See docs/explanation/boundaries.md.
"""

from typing import Any, Literal

from vgmpi.runtime.config.schema import StrictModel
from vgmpi.scene.keyframes import Time
from vgmpi.scene.probes import refuse_balance
from vgmpi.scene.scene_feature import Errors, InitialParticles, SceneFeature, SceneTables

# Keys that a body with prescribed motion cannot have: it neither moves freely nor shares space.
KEYS_EXCLUDED_BY_MOTION = (
    "velocity",
    "angular_velocity",
    "velocity_mode",
    "volume_fraction",
    "volume_fraction_profile",
)
# Keys of a body that exclude regions, with the reason.
REGIONS_EXCLUDED_BY = {
    "motion": "all of it is one rigid body until it is let go",
    "release_time": "all of it stays where it is until it is let go",
}


class ObjectKeys(StrictModel):
    """Keys that prescribed motion adds to [[object]]."""

    release_time: Time | None = None
    """bodies only, of any material: it stays fixed until this time, independent of contact, and is
    then released. A load with this `start_time` can give it a velocity"""
    release_order: Literal["bottom-up", "top-down"] | None = None
    """frozen bodies except solids: released in layers of one cell, one after the other, from
    `release_time` on. Default: all at once"""
    release_end_time: Time | None = None
    """with `release_order`: time at which the last layer is released"""


class PrescribedMotion(SceneFeature):
    """Bodies with prescribed motion in the tables of a scene."""

    name, title = "prescribed_motion", "bodies with prescribed motion"
    force_source = "one with motion or release_time"
    object_keys, moves_bodies = ObjectKeys, True

    def check_object(self, raw: dict, is_scenery: bool) -> Errors:
        """Return the errors of one object as read."""
        return validate_prescribed(raw, is_scenery)

    def check_scene(self, objects: list, materials: dict, couplings: list, accuracy: Any) -> Errors:
        """Return the errors of bodies that are released in layers.

        Args:
            objects, materials, couplings, accuracy: See `SceneFeature.check_scene`.
        """
        return [
            (("object", k, key), message)
            for k, obj in enumerate(objects)
            if (material := materials.get(obj.material)) is not None
            for key, message in validate_release(obj, material.family)
        ]

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes whose balance of momentum lacks what drives the bodies.

        Args:
            probes, tables: See `SceneFeature.check_probes`.
        """
        if not any(obj and is_prescribed(obj) for obj in tables.objects):
            return []
        message = "is not for scenes with bodies that are driven: what drives them is no part of it"
        return refuse_balance(probes, message)

    def has_force(self, obj: Any) -> bool:
        """Return whether the motion of a body is prescribed."""
        return is_prescribed(obj)

    def phases(self, scene: Any) -> dict[str, tuple[int, ...]]:
        """Return the rows of the bodies of each phase with prescribed motion, by its name.

        Bodies of one material that are frozen and released together share a phase.
        """
        rows_by_key: dict[tuple, list[int]] = {}
        for k, obj in enumerate(scene.object):
            if is_prescribed(obj):
                key: tuple = (k,)
                if obj.motion is None:
                    how = obj.release_time, obj.release_order, obj.release_end_time
                    key = ("frozen", scene.phase_of(obj), obj.material, *how)
                rows_by_key.setdefault(key, []).append(k)
        rows_by_name = {}
        for rows in rows_by_key.values():
            obj = scene.object[rows[0]]
            rows_by_name[f"{obj.name} ({'driven' if obj.motion else 'frozen'})"] = tuple(rows)
        return rows_by_name

    def prepare(self, scene: Any, particles: InitialParticles, colliders: list) -> Any:
        """Return the corners [m] of the particles of each such body, or None without any.

        Args:
            scene, particles, colliders: See `SceneFeature.prepare`.
        """
        from vgmpi.preprocess.motion_checks import extent  # it compiles

        entries = [
            (k, particles.entries[k]) for k, obj in enumerate(scene.object) if is_prescribed(obj)
        ]
        return {
            k: extent(particles.x[entry["first_row"] :][: entry["row_count"]])
            for k, entry in entries
        } or None

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the bodies, and the draft with their groups last.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        phases = self.phases(draft.scene)
        if not phases:
            return None, draft
        from .plan import plan_prescribed_motion

        return plan_prescribed_motion(draft, prepared or {}, phases)


def is_prescribed(obj: Any) -> bool:
    """Return whether an object is a body with prescribed motion, or frozen for a time."""
    return obj.role == "body" and (obj.motion is not None or obj.release_time is not None)


def validate_prescribed(raw: dict, is_scenery: bool) -> Errors:
    """Return (path, message) for keys that exclude a body's motion, or its being frozen.

    Args:
        raw: Table of the object.
        is_scenery: Whether it is scenery.
    """
    if is_scenery:
        message = "is not for scenery: it has no mass and does not move"
        return [((key,), message) for key in ObjectKeys.model_fields if key in raw]
    if raw.get("rigid") is True:
        message = "is not for rigid bodies: they have no particles and move freely"
        return [((key,), message) for key in ObjectKeys.model_fields if key in raw]
    errors: Errors = [
        (("region",), f"is not for a body with {key}: {reason}")
        for key, reason in REGIONS_EXCLUDED_BY.items()
        if key in raw and "region" in raw
    ]
    driven = [key for key in ("motion", "release_time") if key in raw]
    if len(driven) > 1:
        message = "motion and release_time given at once: give one"
        errors.append((("release_time",), message))
    for key in KEYS_EXCLUDED_BY_MOTION if driven else ():
        if key not in raw:
            continue
        message = f"is not for a body with {driven[0]}: until it is let go it "
        motion = "moves as that says" if driven[0] == "motion" else "stays where it is"
        message += "shares its space with none" if "volume_fraction" in key else motion
        if key in ("velocity", "angular_velocity") and driven == ["release_time"]:
            message += f"; [[load]] delta_{key} with start_time = release_time gives it one then"
        errors.append(((key,), message))
    for key, other in (("release_order", "release_time"), ("release_end_time", "release_order")):
        if key in raw and other not in raw:
            errors.append(((key,), f"is only for bodies with {other}"))
    if "release_order" in raw and "release_end_time" not in raw:
        errors.append((("release_order",), "needs release_end_time: when the last layer is let go"))
    return errors


def validate_release(obj: Any, family: str) -> list[tuple[str, str]]:
    """Return (key, message) for what forbids releasing a body of a material family in layers."""
    errors, first, last = [], obj.release_time, obj.release_end_time
    if obj.release_order is not None and family == "solid":
        errors.append(("release_order", "is not for solids: their layers would come apart"))
    if first is not None and last is not None and last <= first:
        message = f"must be later than release_time = {first:g} s; got {last:g} s"
        errors.append(("release_end_time", message))
    return errors


FEATURE = PrescribedMotion()
