"""Of render.toml what says how things look: [look], [liquid] and [light]; and what all its tables
have in common."""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator

from vgmpi.splatting.light import Light
from vgmpi.studio import lighting
from vgmpi.tables import LEAST, MOST, Colour, Quantity, Table, three


def _vector(value: Any) -> tuple[float, float, float]:
    numbers = three(value)
    if numbers is None:
        raise ValueError("must be three numbers [x, y, z]")
    if max(map(abs, numbers)) > MOST:
        raise ValueError(f"must be of numbers up to {MOST:g} in size")
    return numbers


def _direction(value: Any) -> tuple[float, float, float]:
    value = _vector(value)
    if not any(value):
        raise ValueError("must be a direction that is not zero")
    if max(map(abs, value)) < LEAST:
        raise ValueError(f"must be a direction of a length from {LEAST:g}")
    return value


def _degrees(value: Any) -> Any:
    """Of a text with a unit; numbers are degrees already."""
    if not isinstance(value, str):
        return value
    try:
        return round(math.degrees(Quantity("rad").parse(value)), 12)
    except ValueError:
        raise ValueError("must be a number of degrees, or a text as '30 deg', '0.5 rad'") from None


Vector = Annotated[tuple[float, float, float], BeforeValidator(_vector)]
Degrees = Annotated[float, BeforeValidator(_degrees)]
Direction = Annotated[tuple[float, float, float], BeforeValidator(_direction)]


class RenderTable(Table):
    model_config = ConfigDict(allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _of_a_size(cls, value: Any) -> Any:
        """Squares and cubes of all numbers are numbers."""
        if isinstance(value, float) and value and not LEAST <= abs(value) <= MOST:
            raise ValueError(f"must be 0 or from {LEAST:g} to {MOST:g} in size")
        return value


class SurroundingsSettings(RenderTable):
    """What liquids mirror: a gradient, or a picture of all directions."""

    zenith: Colour = (0.45, 0.65, 0.9)
    horizon: Colour = (0.93, 0.95, 0.97)
    ground: Colour = (0.5, 0.48, 0.45)
    picture: str | None = None  # twice as wide as high, up above; relative to render.toml's folder


class LightSettings(RenderTable):
    """A light from far away: shadows on all that is drawn, and shades of what is turned away."""

    direction: Direction | None = None  # in which it travels
    key: Annotated[float, Field(ge=0, le=10)] = lighting.KEY  # strength on a surface that faces it
    sky: Annotated[float, Field(ge=0, le=10)] = lighting.SKY  # strength of the light from all sides
    width: Annotated[float, Field(ge=0.005, le=0.5)] = lighting.WIDTH  # half width: soft shadows
    cells: Annotated[int, Field(ge=16, le=400)] = 150  # of what hides light, along the domain
    captures: Annotated[float, Field(ge=0, le=1)] | None = None  # how much of it captures take
    shadow: Annotated[float, Field(ge=0, le=1)] = Light.shadow
    softness: Annotated[float, Field(ge=0, le=1)] = Light.softness
    shade: Annotated[float, Field(ge=0, le=1)] = Light.shade
    contact: Annotated[float, Field(ge=0, le=1)] = Light.contact

    def light(self) -> Light:
        """The light of preset "paper"."""
        names = ("shadow", "softness", "shade", "contact")
        own = {name: getattr(self, name) for name in names}
        return Light(self.direction or Light.direction, **own)


class LiquidSettings(RenderTable):
    """Liquids that are drawn with a surface (look.liquid = "surface")."""

    method: Literal["field", "filter"] | None = None  # a field in space, or a filter of depths
    fine: Annotated[float, Field(ge=1, le=4)] = 2.5  # cells of the field in a spacing
    scatter: Annotated[float, Field(ge=0)] | None = None  # own light [1/m]; by the opacities
    walls: bool = True  # whether the domain's walls cut it flat
    index: Annotated[float, Field(ge=1.0, le=3.0)] = 1.333  # of refraction
    # way after which white light has the liquid's colour [m]; default: a third of what is in view
    clear: Annotated[float, Field(gt=0)] | None = None
    highlight: Annotated[float, Field(ge=0, le=100)] = 2.0
    roughness: Annotated[Degrees, Field(ge=0.1, le=60)] = 3.0  # half width of the highlight
    surroundings: SurroundingsSettings = SurroundingsSettings()


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if not 1.0 <= value[0] <= value[1] <= 20.0:
        raise ValueError("must be two numbers [low, high] with 1 <= low <= high <= 20")
    return value


class LookSettings(RenderTable):
    """How Gaussians follow their particles. None: what the scene says (vgmpi/scene/settings.py)."""

    preset: Literal["studio", "paper"] = "studio"  # paper: Gaussians as they are, without a studio
    liquid: Literal["gaussians", "surface"] | None = None  # how fluids are drawn
    children: Annotated[int, Field(strict=True, ge=1, le=64)] = 16  # of a particle of sand or snow
    tear: Annotated[tuple[float, float], AfterValidator(_ascending)] = (1.8, 4.5)  # spacings
    dust: Annotated[float, Field(ge=0, le=1)] = 0.03  # opacity
    foam: Annotated[float, Field(ge=0, le=1)] = 0.8  # most that is white
    colour_transfer: Literal["off", "frame", "relax"] | None = None  # step is the run's own
    colour_time: Annotated[float, Field(gt=0)] | None = None  # s
    colour_degree: Annotated[int, Field(strict=True, ge=0, le=3)] | None = None
    colour_bodies: tuple[str, ...] | None = None
    covariance: Literal["evolve", "fixed"] = "evolve"  # fixed: the shapes at rest
    harmonics: Literal["rotate", "fixed"] = "rotate"  # fixed: colours do not turn with solids
    opacity: Literal["scaled", "fixed"] = "scaled"  # fixed: as captured, no opacity_scale
    # shapes of fluids, sand and snow; None: deformation where F is known, else volume
    normalise: Literal["volume", "radius", "deformation"] | None = None
    opacity_scale: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}  # by the object's name
    # by the object's name: up to how much brighter or darker each particle is than its colour
    grain: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}

    def colours(self) -> dict[str, Any]:
        """What is said of colours that travel, by the names of the scene's [appearance]."""
        return {k: v for k, v in self if k.startswith("colour_") and v is not None}
