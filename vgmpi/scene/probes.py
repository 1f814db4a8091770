"""Probes of a scene: what is measured while it runs, where and how often."""

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator

from vgmpi.misspelt import nearest
from vgmpi.scene.objects import Object, body_complaint, checked_name, one_complaint
from vgmpi.tables import Length, Point, Quantity, Table

KINDS = ("pressure", "level", "velocity", "object", "wall", "collider")
SIDES = ("west", "east", "south", "north", "floor", "roof")


class Probe(Table):
    """A measurement, written to probe_NAME.csv: exactly one of pressure, level, velocity, object,
    wall, collider. A row is written after the first step at or after each due time, and says its
    own time: probes do not change the steps.
    """

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    rate: Annotated[float, Quantity("Hz", gt=0)] | None = None
    """rows per second of simulated time"""
    every: Annotated[float, Quantity("s", gt=0)] | None = None
    """instead of `rate`: time between rows; shorter than a step: a row at every step"""
    pressure: Point | None = None
    """mean pressure of the fluids within a cell of this point, weighted by their volume and by
    1 - distance / cell along each axis"""
    level: tuple[Length, Length] | None = None
    """height of the fluids' surface over this point (x, y): of the highest layer of a cell's
    height that they fill by half"""
    velocity: Point | None = None
    """mean velocity of all bodies within a cell of this point, weighted by mass and by
    1 - distance / cell along each axis"""
    object: str | None = None
    """a body's mass, centre of mass, mean velocity, momentum, and the mean force on it since the
    row before: the rate of its momentum without its weight"""
    wall: Literal["all", "west", "east", "south", "north", "floor", "roof"] | None = None
    """"all": mean force of the bodies on all walls and colliders together since the row before,
    from the balance of momentum: weight and loads less the rate of the bodies' momentum: z is what
    floor and roof bear, and the friction at the sides. Not for scenes where particles come or go.
    The name of one wall: mean force of the bodies on it since the row before, and mean torque about
    its middle"""
    collider: str | None = None
    """a collider, moving or not, or a body while it is driven (those that are frozen alike as one):
    mean force of the others on it since the row before, mean torque about the point that it turns
    about (where that is now; of one at rest the middle of its extent), and the work that it has
    done on them since then"""

    @property
    def kind(self) -> str:
        """What it measures."""
        if self.wall in SIDES:
            return "one wall"
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def feels(self) -> bool:
        """Whether it asks what a collider or a wall of its own gives."""
        return self.collider is not None or self.wall in SIDES

    @property
    def period(self) -> float:
        """Time between rows [s]."""
        return self.every if self.every is not None else 1.0 / (self.rate or math.inf)

    def due(self, before: float, now: float) -> bool:
        """Whether a row is due after a step from `before` to `now` [s]; from the times alone, so
        that a resumed run writes the same rows."""
        # frames land on their times to rounding: a millionth of a period is on time
        return math.floor(now / self.period + 1e-6) > math.floor(before / self.period + 1e-6)


def probe_complaints(
    raw: dict,
    probe: Probe | None,
    role: dict[str, str] | None,
    size: tuple[float, float, float] | None,
    fluid: bool,
    colliders: list[str] | None,
) -> list[tuple[tuple, str]]:
    """(path, text) for what is wrong with one probe beside its values. probe: as read, None if
    that failed; role: see objects.body_complaint; size: of the domain [m]; fluid: is there any;
    colliders: names, or None where they are not known.
    """
    found = one_complaint(raw, KINDS, "measures nothing")
    if "rate" not in raw and "every" not in raw:
        found.append(((), "needs a rate or an every"))
    if "rate" in raw and "every" in raw:
        found.append((("every",), "rate and every given at once: give one"))
    if probe is None:
        return found
    said = body_complaint(probe.object, role)
    found += [(("object",), said)] if said else []
    said = _collider_complaint(probe.collider, role, colliders)
    found += [(("collider",), said)] if said else []
    for key in ("pressure", "level", "velocity"):
        point = getattr(probe, key)
        if point is None:
            continue
        if key != "velocity" and not fluid:
            found.append(((key,), "is for fluids, and there is none"))
        for axis, x in enumerate(point if size else ()):
            if not 0 <= x <= size[axis]:
                said = f"lies outside the domain, 0 .. {size[axis]:g} m; got {x:g} m"
                found.append(((key, axis), said))
    return found


def collider_names(objects: list[Object | None]) -> list[str] | None:
    """Names of the colliders among objects as read, and of the bodies that are driven; None where
    one failed."""
    if None in objects:
        return None
    return [thing.name for thing in objects if thing is not None and _pushes(thing)]


def _pushes(thing: Object) -> bool:
    """Whether nothing turns it aside."""
    return thing.collider or thing.driven


def _collider_complaint(
    name: str | None, role: dict[str, str] | None, colliders: list[str] | None
) -> str:
    """Why `name` is not the name of a collider, or nothing."""
    if name is None or role is None or colliders is None or name in colliders:
        return ""
    if name in role:
        return (
            f"'{name}' is no collider: scenery with collider = true is, and a body with motion or"
            " frozen_until"
        )
    known = f"known: {', '.join(colliders)}" if colliders else "there is none"
    return f"there is no collider '{name}'{nearest(name, colliders)}; {known}"
