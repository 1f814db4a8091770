"""What pours into a scene and what leaves it: sources and sinks."""

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator

from vgmpi.scene.forms import Axis, Shape, shape_complaints
from vgmpi.scene.nozzle import Disc, Rectangle, box, spacing, too_small
from vgmpi.scene.objects import checked_name, drawn_from, one_complaint, per_cell
from vgmpi.scene.settings import Domain
from vgmpi.tables import Colour, Quantity, Share, Table

OPENINGS = ("disc", "rectangle")
FLOWS = ("velocity", "rate", "flow")
SECTIONS_NEEDED = ("domain", "time")


class Inflow(Table):
    """A nozzle out of which material pours: exactly one of disc, rectangle, and exactly one of
    velocity, rate, flow. Behind its mouth, upstream, lies a nozzle two cells long, in the domain:
    in it particles are carried along at the speed of the flow, whatever is before them, until they
    are let go .3 cells before the mouth.
    """

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name, among objects too: letters, digits, spaces, _ and -, beginning with a letter"""
    material: str
    """name of a [material.*] table: liquids, pastes, sand, snow; solids only where they can touch
    nothing but what shares their `phase`"""
    disc: Disc | None = None
    """a round mouth: { center, radius }"""
    rectangle: Rectangle | None = None
    """a mouth with corners: { center, width, height }; `width` lies horizontally, along x where it
    pours straight up or down"""
    direction: Axis
    """which way it pours: "x", "y", "z" or three numbers"""
    velocity: Annotated[float, Quantity("m/s", gt=0)] | None = None
    """speed of what comes"""
    rate: Annotated[float, Quantity("kg/s", gt=0)] | None = None
    """instead of `velocity`: mass per time"""
    flow: Annotated[float, Quantity("m3/s", gt=0)] | None = None
    """instead of `velocity`: volume per time, at rest and with pores"""
    start: Annotated[float, Quantity("s", ge=0)] = 0.0
    """when the first material reaches the mouth"""
    end: Annotated[float, Quantity("s", gt=0)] | None = None
    """when the last material passes the mouth; default: never. Particles are kept ready for what
    comes until then or until time.end, so that a run can be extended only beyond an `end`"""
    particles_per_cell: Annotated[int, BeforeValidator(per_cell)] = 8
    """particles per full cell: 1, 8, 27 or 64"""
    phase: str | None = None
    """as of an object"""
    colour: Colour = (0.7, 0.7, 0.7)
    """"#rrggbb" or three numbers 0..1"""
    opacity: Share = 0.95
    """opacity of its Gaussians"""
    opacity_scale: Share = 1.0
    """fluids only: factor on opacities when drawn; water looks like water at 0.005 .. 0.05"""

    # what an object has besides
    role: ClassVar[str] = "source"
    collider: ClassVar[bool] = False
    deforms: ClassVar[bool | None] = None
    motion: ClassVar[None] = None
    driven: ClassVar[bool] = False

    @property
    def shaped(self) -> str:
        """The key that gives its mouth."""
        return next(key for key in OPENINGS if getattr(self, key) is not None)

    @property
    def opening(self) -> Disc | Rectangle:
        """Its mouth."""
        found: Disc | Rectangle = getattr(self, self.shaped)
        return found

    @property
    def drawn_from(self) -> float:
        """The faintest contribution that is drawn."""
        return drawn_from(self.opacity_scale)


class Sink(Table):
    """A region in which particles end: those that are inside are taken away after every fourth
    step."""

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    shape: Shape
    """the region, in domain coordinates"""


def source_complaints(
    raw: dict, source: Inflow | None, kinds: dict[str, Any], tables: dict[str, Any],
    objects: list[Any],
) -> list[tuple[tuple, str]]:  # fmt: skip
    """(path, text) for what is wrong with one source beside its values. source: as read, None if
    that failed; kinds: materials by name; tables: sections by name; objects: those of the scene,
    None for those with errors.
    """
    found = one_complaint(raw, OPENINGS, "has no mouth")
    found += one_complaint(raw, FLOWS, "has no flow")
    if raw.get("name") in [thing.name for thing in objects if thing]:
        found.append((("name",), "is taken: an object has the same name"))
    made_of = kinds.get(raw.get("material", ""), None) if _text(raw, "material") else None
    if made_of is not None and made_of.family != "fluid" and "opacity_scale" in raw:
        found.append((("opacity_scale",), "is only for fluids; others have opacity"))
    if source is None or found:
        return found
    if source.end is not None and source.end <= source.start:
        said = f"must be later than start = {source.start:g} s; got {source.end:g} s"
        found.append((("end",), said))
    domain, time = (tables.get(name) for name in SECTIONS_NEEDED)
    if time is not None and source.start >= time.end:
        said = f"nothing comes: the run ends at {time.end:g} s; got {source.start:g} s"
        found.append((("start",), said))
    return found + (_misplaced(source, domain) if domain is not None else [])


def _text(raw: dict, key: str) -> bool:
    return isinstance(raw.get(key), str)


def _misplaced(source: Inflow, domain: Domain) -> list[tuple[tuple, str]]:
    """(path, text) where the nozzle is no place for particles."""
    if too_small(source, domain.cell):
        apart = spacing(source, domain.cell)
        return [((source.shaped,), f"too small: no particle fits in, their spacing is {apart:g} m")]
    low, high = box(source, domain.cell)
    beyond = (low < 0) | (high > domain.size)
    if not beyond.any():
        return []
    a = int(np.argmax(beyond))
    said = (
        f"the nozzle leaves the domain: with two cells behind its mouth it reaches"
        f" {'xyz'[a]} = {low[a]:.4g} .. {high[a]:.4g} m, the domain 0 .. {domain.size[a]:g} m"
    )
    return [((source.shaped,), said)]


def sink_complaints(raw: dict, sources: list[Any]) -> list[tuple[tuple, str]]:
    """(path, text) for what is wrong with one sink beside its values. sources: those of the scene,
    None for those with errors."""
    found = []
    if raw.get("name") in [source.name for source in sources if source]:
        found.append((("name",), "is taken: a source has the same name"))
    if "shape" in raw:
        found += shape_complaints(raw["shape"], ("shape",))
    return found


def balance_complaints(
    probes: list[Any], flows: bool, objects: list[Any]
) -> list[tuple[tuple, str]]:
    """(path, text) of probes that measure by a balance, in a scene where something comes or goes
    (flows) or bodies are driven."""
    driven = any(thing and thing.driven for thing in objects)
    if not (flows or driven):
        return []
    said = "is not for scenes where particles come or go: these are no part of its balance"
    if driven:
        said = "is not for scenes with bodies that are driven: what drives them is no part of it"
    every = enumerate(probes)
    return [(("probe", k, "wall"), said) for k, one in every if one and one.wall == "all"]
