"""Loads of a scene: what pushes a body, where, how strongly and when."""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from vgmpi.scene.forms import Shape, shape_complaints
from vgmpi.scene.objects import body_complaint, one_complaint
from vgmpi.tables import Quantity, Table

Newton = Annotated[float, Quantity("N")]
NewtonSecond = Annotated[float, Quantity("N s")]
Acceleration = Annotated[float, Quantity("m/s2")]
Speed = Annotated[float, Quantity("m/s")]
Turning = Annotated[float, Quantity("rad/s")]
# axis and side of each face; a pressure on it pushes the other way
FACES = {
    "west": (0, -1),
    "east": (0, 1),
    "south": (1, -1),
    "north": (1, 1),
    "bottom": (2, -1),
    "top": (2, 1),
}
LASTING = ("force", "pressure", "acceleration")
AT_ONCE = ("impulse", "velocity", "spin")  # given in one step
STRENGTHS = (*LASTING, *AT_ONCE)


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


class Load(Table):
    """A push on bodies, besides gravity: exactly one of force, pressure, acceleration, which last,
    and impulse, velocity, spin, which are given all at once, `after` a time. It changes the
    momentum and the energy that ledger.csv shows.
    """

    object: Annotated[tuple[str, ...], BeforeValidator(_listed)]
    """name of the body, or a list of them"""
    region: Shape | None = None
    """only the particles inside at the start, a shape in domain coordinates; they keep the load
    wherever they go"""
    force: tuple[Newton, Newton, Newton] | None = None
    """force on all of them together, shared by rest volume"""
    pressure: Annotated[float, Quantity("Pa")] | None = None
    """presses on `face`: a force of pressure times the face of the box around the particles, on
    the particles within one particle spacing of that face. Its direction does not turn"""
    face: Literal["west", "east", "south", "north", "bottom", "top"] | None = None
    """where the pressure acts: towards low x, high x, low y, high y, low z, high z"""
    acceleration: tuple[Acceleration, Acceleration, Acceleration] | None = None
    """of every particle"""
    impulse: tuple[NewtonSecond, NewtonSecond, NewtonSecond] | None = None
    """on all of them together, shared by rest volume"""
    velocity: tuple[Speed, Speed, Speed] | None = None
    """by which that of every particle changes"""
    spin: tuple[Turning, Turning, Turning] | None = None
    """angular velocity by which that of all of them changes, about their centre of mass then"""
    ramp: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time in which a load that lasts grows from 0, as half a cosine; 0: at once"""
    after: Annotated[float, Quantity("s", ge=0)] = 0.0
    """when it begins, or is given: in the step that begins then or comes to it"""
    until: Annotated[float, Quantity("s", gt=0)] | None = None
    """when a load that lasts ends; default: never"""

    @property
    def at_once(self) -> bool:
        """Whether it is given in one step."""
        return any(getattr(self, key) is not None for key in AT_ONCE)

    def amount(self, t0: float, t1: float, dt: float) -> float:
        """What it gives between two times [s] that are dt [s] apart, over its full strength [s]; of
        one that is given at once 1 or 0: the step that holds its time gives it."""
        if self.at_once:
            return float(t0 <= self.after < t1)
        return dt * mean_share(t0, t1, self.ramp, self.after, self.until)


def mean_share(
    t0: float, t1: float, ramp: float, after: float = 0.0, until: float | None = None
) -> float:
    """Mean over t0 .. t1 [s] of a share that grows from 0 at `after` to 1 as half a cosine.

    The integral is exact, so that the impulse up to a time does not depend on the steps.
    """
    first, last = max(t0, after), t1 if until is None else min(t1, until)
    if last <= first:
        return 0.0
    if first - after >= ramp:
        return (last - first) / (t1 - t0)
    return (_grown(last - after, ramp) - _grown(first - after, ramp)) / (t1 - t0)


def _grown(s: float, ramp: float) -> float:
    """Integral of (1 - cos(pi t / ramp)) / 2 from 0 to s, of 1 beyond the ramp."""
    if s >= ramp:
        return s - 0.5 * ramp
    return 0.5 * s - 0.5 * ramp / math.pi * math.sin(math.pi * s / ramp)


def load_complaints(
    raw: dict, load: Load | None, role: dict[str, str] | None
) -> list[tuple[tuple, str]]:
    """(path, text) for what is wrong with one load beside its values. load: as read, None if that
    failed; role: see objects.body_complaint.
    """
    found = one_complaint(raw, STRENGTHS, "pushes with nothing")
    if "pressure" in raw and "face" not in raw:
        found.append((("face",), f"required with pressure: one of {', '.join(FACES)}"))
    if "face" in raw and "pressure" not in raw:
        found.append((("face",), "is for pressure only"))
    for key in ("ramp", "until"):
        if key in raw and not any(strong in raw for strong in LASTING):
            found.append(((key,), "is for loads that last, this one is given at once"))
    if "region" in raw:
        found += shape_complaints(raw["region"], ("region",))
    if load is None:
        return found
    if not load.object:
        found.append((("object",), "names no object"))
    if load.until is not None and load.until <= load.after:
        said = f"must be later than after = {load.after:g} s; got {load.until:g} s"
        found.append((("until",), said))
    for place, name in enumerate(load.object):
        said = body_complaint(name, role)
        path = ("object", place) if isinstance(raw["object"], list) else ("object",)
        found += [(path, said)] if said else []
    return found
