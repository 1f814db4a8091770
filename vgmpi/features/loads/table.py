"""Loads of a scene: forces, pressures and impulses on bodies."""

from typing import Annotated, Literal

from pydantic import BeforeValidator

from vgmpi.runtime.config.schema import Quantity, StrictModel, as_names
from vgmpi.scene.keyframes import mean_ramp_factor
from vgmpi.scene.objects import validate_body_name, validate_exactly_one
from vgmpi.scene.scene_feature import Errors
from vgmpi.scene.shapes import Shape, validate_shape

Newton = Annotated[float, Quantity("N")]
NewtonSecond = Annotated[float, Quantity("N s")]
Acceleration = Annotated[float, Quantity("m/s2")]
Speed = Annotated[float, Quantity("m/s")]
AngularVelocity = Annotated[float, Quantity("rad/s")]
# Axis and side of each face; a pressure on it acts in the opposite direction.
FACES = {
    "west": (0, -1),
    "east": (0, 1),
    "south": (1, -1),
    "north": (1, 1),
    "bottom": (2, -1),
    "top": (2, 1),
}
SUSTAINED = ("force", "pressure", "acceleration", "damping")
IMPULSIVE = ("impulse", "delta_velocity", "delta_angular_velocity")  # they act in one step
STRENGTHS = (*SUSTAINED, *IMPULSIVE)


class Load(StrictModel):
    """Load on bodies in addition to gravity: exactly one kind of load.

    force, pressure, acceleration and damping are continuous; impulse, delta_velocity and
    delta_angular_velocity act in one step, at the time `start_time`. A load changes momentum and
    energy in ledger.csv.
    """

    object: Annotated[tuple[str, ...], BeforeValidator(as_names)]
    """name of the body, or a list of them"""
    region: Shape | None = None
    """apply the load only to the particles inside this shape at the start (domain coordinates),
    wherever they move later"""
    force: tuple[Newton, Newton, Newton] | None = None
    """total force, distributed by rest volume"""
    pressure: Annotated[float, Quantity("Pa")] | None = None
    """pressure on `face`: a force of pressure times the face of the bounding box, on the particles
    within one particle spacing of that face. Its direction is constant"""
    face: Literal["west", "east", "south", "north", "bottom", "top"] | None = None
    """face of the bounding box: at low x, high x, low y, high y, low z, high z"""
    acceleration: tuple[Acceleration, Acceleration, Acceleration] | None = None
    """acceleration of every particle"""
    damping: Annotated[float, Quantity("1/s", gt=0)] | None = None
    """mass-proportional damping coefficient (Rayleigh's alpha): a force of -damping mass velocity.
    The velocity of a free body decays as exp(-damping t) at any time step. Twice the angular
    frequency of the slowest vibration brings a body to rest soonest"""
    impulse: tuple[NewtonSecond, NewtonSecond, NewtonSecond] | None = None
    """total impulse, distributed by rest volume"""
    delta_velocity: tuple[Speed, Speed, Speed] | None = None
    """velocity change of every particle"""
    delta_angular_velocity: tuple[AngularVelocity, AngularVelocity, AngularVelocity] | None = None
    """change of the angular velocity of all of them, about their center of mass at that time"""
    ramp_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time in which a continuous load grows from 0, as half a cosine; 0: at once"""
    start_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time at which it begins, or acts: in the step that contains this time"""
    end_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """time at which a continuous load ends; default: never"""

    @property
    def at_once(self) -> bool:
        """Return whether it acts in one step."""
        return any(getattr(self, key) is not None for key in IMPULSIVE)

    def amount(self, t0: float, t1: float, dt: float) -> float:
        """Return the time integral of the load between two times over its full strength [s].

        For an impulsive load this is 1 in the step that contains its time, else 0.

        Args:
            t0: Start of the step [s].
            t1: End of the step [s].
            dt: Length of the step [s].
        """
        if self.at_once:
            return float(t0 <= self.start_time < t1)
        return dt * mean_ramp_factor(t0, t1, self.ramp_time, self.start_time, self.end_time)


def validate_load(raw: dict, load: Load | None, role: dict[str, str] | None) -> Errors:
    """Return (path, message) for errors of one load besides its values.

    Args:
        raw: Table as read.
        load: Validated table, or None if that failed.
        role: Roles of the objects, see `objects.validate_body_name`.
    """
    errors = validate_exactly_one(raw, STRENGTHS, "pushes with nothing")
    if "pressure" in raw and "face" not in raw:
        errors.append((("face",), f"required with pressure: one of {', '.join(FACES)}"))
    if "face" in raw and "pressure" not in raw:
        errors.append((("face",), "is for pressure only"))
    for key in ("ramp_time", "end_time"):
        if key in raw and not any(strength in raw for strength in SUSTAINED):
            errors.append(((key,), "is for loads that last, this one is given at once"))
    if "region" in raw:
        errors += validate_shape(raw["region"], ("region",))
    if load is None:
        return errors
    if not load.object:
        errors.append((("object",), "names no object"))
    if load.end_time is not None and load.end_time <= load.start_time:
        message = f"must be later than start_time = {load.start_time:g} s; got {load.end_time:g} s"
        errors.append((("end_time",), message))
    for index, name in enumerate(load.object):
        message = validate_body_name(name, role)
        path = ("object", index) if isinstance(raw["object"], list) else ("object",)
        errors += [(path, message)] if message else []
    return errors
