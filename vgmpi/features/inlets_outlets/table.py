"""Inlets and outlets of a scene: the tables [[inlet]] and [[outlet]]."""

from typing import Annotated

import numpy as np
from pydantic import BeforeValidator

from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.scene.objects import checked_name, validate_exactly_one
from vgmpi.scene.scene_feature import Errors, ParticleSource, SceneTables
from vgmpi.scene.sections import Domain
from vgmpi.scene.shapes import Axis, Shape, validate_shape

from .geometry import (
    TOUCH_TOLERANCE_CELLS,
    Disc,
    Rectangle,
    bounding_box,
    spacing,
    too_small,
)

OPENINGS = ("disc", "rectangle")
FLOWS = ("speed", "mass_flow_rate", "volume_flow_rate")


class Inlet(ParticleSource):
    """Inlet: one of disc, rectangle, and one of speed, mass_flow_rate, volume_flow_rate.

    A nozzle two cells long lies upstream of the mouth, inside the domain; it may end on a wall. Its
    particles move with the prescribed velocity. They are released one by one, 0.2 cells before the
    mouth.
    """

    material: str
    """name of a [material.*] table: liquids, pastes, sand, snow; solids only if they can touch
    nothing outside their `phase`"""
    disc: Disc | None = None
    """a round mouth: { center, radius }"""
    rectangle: Rectangle | None = None
    """a mouth with corners: { center, width, height }; `width` is horizontal, along x for a
    vertical flow"""
    direction: Axis = (0.0, 0.0, -1.0)
    """direction of the flow: "x", "-x", "y", "-y", "z", "-z" or three numbers; default: down"""
    speed: Annotated[float, Quantity("m/s", gt=0)] | None = None
    """speed of the flow"""
    mass_flow_rate: Annotated[float, Quantity("kg/s", gt=0)] | None = None
    """instead of `speed`: mass per time"""
    volume_flow_rate: Annotated[float, Quantity("m3/s", gt=0)] | None = None
    """instead of `speed`: volume per time, at rest and including pores"""
    start_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """when the first material reaches the mouth"""
    end_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """when the last material passes the mouth; default: never. The particles until then, or until
    time.end, are allocated at the start, so a run can be extended only beyond an `end_time`"""

    @property
    def opening_kind(self) -> str:
        """Return the key that gives the shape of its mouth."""
        return next(key for key in OPENINGS if getattr(self, key) is not None)

    @property
    def opening(self) -> Disc | Rectangle:
        """Return the shape of its mouth."""
        mouth: Disc | Rectangle = getattr(self, self.opening_kind)
        return mouth


class Outlet(StrictModel):
    """Outlet: particles inside the region are removed after every fourth step."""

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    shape: Shape
    """the region, in domain coordinates"""
    start_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """when it opens; one that opens later may hold a body at the start, as the drain of a full
    tub does. Default: open from the start"""


def validate_inlet(raw: dict, inlet: Inlet | None, tables: SceneTables) -> Errors:
    """Return (path, message) for errors of one inlet besides its values.

    Args:
        raw: Table as read.
        inlet: Validated table, or None if that failed.
        tables: Tables of the scene.
    """
    errors = validate_exactly_one(raw, OPENINGS, "has no mouth")
    errors += validate_exactly_one(raw, FLOWS, "has no flow")
    if raw.get("name") in [obj.name for obj in tables.objects if obj]:
        errors.append((("name",), "is taken: an object has the same name"))
    name = raw.get("material")
    material = tables.materials.get(name) if isinstance(name, str) else None
    if material is not None and material.family != "fluid" and "opacity_scale" in raw:
        errors.append((("opacity_scale",), "is only for fluids; others have opacity"))
    if inlet is None or errors:
        return errors
    if inlet.end_time is not None and inlet.end_time <= inlet.start_time:
        message = (
            f"must be later than start_time = {inlet.start_time:g} s; got {inlet.end_time:g} s"
        )
        errors.append((("end_time",), message))
    domain, time = tables.sections.get("domain"), tables.sections.get("time")
    if time is not None and inlet.start_time >= time.end:
        message = f"nothing comes: the run ends at {time.end:g} s; got {inlet.start_time:g} s"
        errors.append((("start_time",), message))
    return errors + (_validate_nozzle(inlet, domain) if domain is not None else [])


def _validate_nozzle(inlet: Inlet, domain: Domain) -> Errors:
    """Return (path, message) where the nozzle cannot hold particles."""
    if too_small(inlet, domain.cell):
        distance = spacing(inlet, domain.cell)
        return [
            (
                (inlet.opening_kind,),
                f"too small: no particle fits in, their spacing is {distance:g} m",
            )
        ]
    low, high = bounding_box(inlet, domain.cell)
    tolerance = TOUCH_TOLERANCE_CELLS * domain.cell
    outside = (low < -tolerance) | (high > np.array(domain.size) + tolerance)
    if not outside.any():
        return []
    a = int(np.argmax(outside))
    message = (
        f"the nozzle leaves the domain: with two cells behind its mouth it reaches"
        f" {'xyz'[a]} = {low[a]:.4g} .. {high[a]:.4g} m, the domain 0 .. {domain.size[a]:g} m"
    )
    return [((inlet.opening_kind,), message)]


def validate_outlet(raw: dict, inlets: list) -> Errors:
    """Return (path, message) for errors of one outlet besides its values.

    Args:
        raw: Table as read.
        inlets: Inlets of the scene, None in place of invalid ones.
    """
    errors: Errors = []
    if raw.get("name") in [inlet.name for inlet in inlets if inlet]:
        errors.append((("name",), "is taken: an inlet has the same name"))
    if "shape" in raw:
        errors += validate_shape(raw["shape"], ("shape",))
    return errors
