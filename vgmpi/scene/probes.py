"""Probes of a scene: quantities measured during the run."""

import math
from collections.abc import Container
from typing import Annotated, Literal

from pydantic import BeforeValidator

from vgmpi.runtime.config.schema import Length, Point, Quantity, StrictModel
from vgmpi.runtime.message_text import did_you_mean

from .objects import Object, checked_name, validate_body_name, validate_exactly_one
from .scene_feature import features

KINDS = ("pressure", "surface_height", "velocity", "object", "wall", "collider", "joint")
WALL_NAMES = ("west", "east", "south", "north", "bottom", "top")


class Probe(StrictModel):
    """Measurement, written to probe_NAME.csv: exactly one quantity.

    It is one of pressure, surface_height, velocity, object, wall, collider, joint. A row is written
    after the first step at or after each sampling time, with the time of that step. Probes do not
    change the time steps.
    """

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    sampling_rate: Annotated[float, Quantity("Hz", gt=0)] | None = None
    """rows per second of simulated time"""
    sampling_interval: Annotated[float, Quantity("s", gt=0)] | None = None
    """instead of `sampling_rate`: time between rows; shorter than a step: a row at every step"""
    pressure: Point | None = None
    """mean pressure of the fluids within a cell of this point, weighted by their volume and by
    1 - distance / cell along each axis"""
    surface_height: tuple[Length, Length] | None = None
    """height of the fluid surface above this point (x, y): the highest layer of one cell that is at
    least half full"""
    velocity: Point | None = None
    """mean velocity of all bodies within a cell of this point, weighted by mass and by
    1 - distance / cell along each axis"""
    object: str | None = None
    """a body's mass, center of mass, mean velocity, momentum, and mean force since the previous
    row: the rate of change of its momentum, without its weight. Of a rigid body also its rotation,
    angular velocity, angular momentum and mean torque about its center of mass"""
    wall: Literal["all", "west", "east", "south", "north", "bottom", "top"] | None = None
    """"all": mean total force of the bodies on all walls and colliders since the previous row, from
    the momentum balance: weight and loads minus the rate of change of the bodies' momentum. z
    contains the forces on bottom and top and the friction at the sides. Not for scenes with inlets,
    outlets or open walls. The name of one wall: mean force of the bodies on it since the previous
    row, and mean torque about its center"""
    collider: str | None = None
    """a collider, moving or not, or a body with prescribed motion (bodies with the same
    `release_time` count as one): mean force of the other bodies on it since the previous row, mean
    torque about its current center of rotation (at rest: the center of its extent), and its work on
    the other bodies since then. That on a collider includes the bodies that are pinned to it. A
    body that is pinned to the world: the same for the world, about the center of mass of its first
    pinned part"""

    joint: str | None = None
    """name of a joint: its angle or displacement, force and torque on its first body, and the power
    of its motor, all in the last step"""

    @property
    def kind(self) -> str:
        """Return the quantity that it measures."""
        if self.wall in WALL_NAMES:
            return "one wall"
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    def kind_among(self, rigid: Container[str]) -> str:
        """Return the quantity that it measures in a scene with rigid bodies of these names."""
        is_rigid = self.object is not None and self.object in rigid
        return "rigid body" if is_rigid else self.kind

    @property
    def measures_reaction(self) -> bool:
        """Return whether it measures the reaction of a collider or of a single wall."""
        return self.collider is not None or self.wall in WALL_NAMES

    @property
    def period(self) -> float:
        """Return the time between rows [s]."""
        return (
            self.sampling_interval
            if self.sampling_interval is not None
            else 1.0 / (self.sampling_rate or math.inf)
        )

    def due(self, before: float, now: float) -> bool:
        """Return whether a row is due after a step from `before` to `now` [s].

        It depends on the times alone, so that a resumed run writes the same rows.
        """
        # Frames hit their times up to rounding: a millionth of a period counts as on time.
        return math.floor(now / self.period + 1e-6) > math.floor(before / self.period + 1e-6)


def validate_probe(
    raw: dict,
    probe: Probe | None,
    role: dict[str, str] | None,
    size: tuple[float, float, float] | None,
    fluid: bool,
    colliders: list[str] | None,
) -> list[tuple[tuple, str]]:
    """Return (path, message) for errors of one probe besides its values.

    Args:
        raw: Table as read.
        probe: Validated table, or None if that failed.
        role: Roles of the objects, see `objects.validate_body_name`.
        size: Size of the domain [m].
        fluid: Whether the scene has a fluid.
        colliders: Names of the colliders, or None if they are unknown.
    """
    errors = validate_exactly_one(raw, KINDS, "measures nothing")
    if "sampling_rate" not in raw and "sampling_interval" not in raw:
        errors.append(((), "needs a sampling_rate or a sampling_interval"))
    if "sampling_rate" in raw and "sampling_interval" in raw:
        errors.append(
            (("sampling_interval",), "sampling_rate and sampling_interval given at once: give one")
        )
    if probe is None:
        return errors
    is_rigid = role is not None and role.get(probe.object or "") == "rigid"
    message = "" if is_rigid else validate_body_name(probe.object, role)
    errors += [(("object",), message)] if message else []
    message = _validate_collider_name(probe.collider, role, colliders)
    errors += [(("collider",), message)] if message else []
    for key in ("pressure", "surface_height", "velocity"):
        point = getattr(probe, key)
        if point is None:
            continue
        if key != "velocity" and not fluid:
            errors.append(((key,), "is for fluids, and there is none"))
        for axis, (x, length) in enumerate(zip(point, size or ())):
            if not 0 <= x <= length:
                message = f"lies outside the domain, 0 .. {length:g} m; got {x:g} m"
                errors.append(((key, axis), message))
    return errors


def refuse_balance(probes: list, message: str) -> list[tuple[tuple, str]]:
    """Return (path, message) of probes that measure by the balance of momentum of all walls.

    Args:
        probes: Probes of the scene, None in place of invalid ones.
        message: Why the balance is not closed.
    """
    every = enumerate(probes)
    return [(("probe", k, "wall"), message) for k, probe in every if probe and probe.wall == "all"]


def collider_names(objects: list[Object | None]) -> list[str] | None:
    """Return the names of colliders and of prescribed bodies, or None if an object is invalid."""
    if None in objects:
        return None
    return [obj.name for obj in objects if obj is not None and _is_rigid(obj)]


def _is_rigid(obj: Object) -> bool:
    """Return whether nothing deflects it."""
    return obj.collider or any(each.has_force(obj) for each in features())


def _validate_collider_name(
    name: str | None, role: dict[str, str] | None, colliders: list[str] | None
) -> str:
    """Return why `name` is not the name of a collider, or an empty text."""
    if name is None or role is None or colliders is None or name in colliders:
        return ""
    if name in role:
        sources = [each.force_source for each in features() if each.force_source]
        others = ", or ".join(sources)
        return f"'{name}' is no collider: scenery with collider = true is, and {others}"
    valid = f"known: {', '.join(colliders)}" if colliders else "there is none"
    return f"there is no collider '{name}'{did_you_mean(name, colliders)}; {valid}"
