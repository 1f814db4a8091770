"""Schema of the tables [look], [liquid] and [light] of render.toml, and its common types."""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator

from vgmpi.runtime.config.schema import (
    MAX_MAGNITUDE,
    MIN_MAGNITUDE,
    Color,
    Quantity,
    StrictModel,
    parse_vector3,
)

from ..raster.shadow_lighting import Light
from ..studio import light_rig


def _vector(value: Any) -> tuple[float, float, float]:
    """Parse a vector of three numbers."""
    numbers = parse_vector3(value)
    if numbers is None:
        raise ValueError("must be three numbers [x, y, z]")
    if max(map(abs, numbers)) > MAX_MAGNITUDE:
        raise ValueError(f"must be of numbers up to {MAX_MAGNITUDE:g} in size")
    return numbers


def _direction(value: Any) -> tuple[float, float, float]:
    """Parse a vector that is not zero."""
    value = _vector(value)
    if not any(value):
        raise ValueError("must be a direction that is not zero")
    if max(map(abs, value)) < MIN_MAGNITUDE:
        raise ValueError(f"must be a direction of a length from {MIN_MAGNITUDE:g}")
    return value


def _degrees(value: Any) -> Any:
    """Convert a text with a unit to degrees; numbers are degrees already."""
    if not isinstance(value, str):
        return value
    try:
        return round(math.degrees(Quantity("rad").parse(value)), 12)
    except ValueError:
        raise ValueError("must be a number of degrees, or a text as '30 deg', '0.5 rad'") from None


Vector = Annotated[tuple[float, float, float], BeforeValidator(_vector)]
Degrees = Annotated[float, BeforeValidator(_degrees)]
Direction = Annotated[tuple[float, float, float], BeforeValidator(_direction)]


class RenderTable(StrictModel):
    """Base class of the tables of render.toml."""

    model_config = ConfigDict(allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _check_magnitude(cls, value: Any) -> Any:
        """Refuse numbers whose squares and cubes are not finite or vanish."""
        if isinstance(value, float) and value and not MIN_MAGNITUDE <= abs(value) <= MAX_MAGNITUDE:
            raise ValueError(f"must be 0 or from {MIN_MAGNITUDE:g} to {MAX_MAGNITUDE:g} in size")
        return value


class EnvironmentSettings(RenderTable):
    """Environment that liquids reflect: a gradient, or an image of all directions."""

    zenith: Color = (0.45, 0.65, 0.9)
    horizon: Color = (0.93, 0.95, 0.97)
    ground: Color = (0.5, 0.48, 0.45)
    # twice as wide as high, up at the top; relative to the folder of render.toml
    picture: str | None = None


class LightSettings(RenderTable):
    """A distant light with shadows and shading."""

    direction: Direction | None = None  # direction of travel
    key: Annotated[float, Field(ge=0, le=10)] = light_rig.KEY  # strength on a facing surface
    sky: Annotated[float, Field(ge=0, le=10)] = light_rig.SKY  # strength of the ambient light
    # half width of the light; softens shadows
    width: Annotated[float, Field(ge=0.005, le=0.5)] = light_rig.WIDTH
    # cells of the occlusion grid along the domain
    cells: Annotated[int, Field(ge=16, le=400)] = 150
    captures: Annotated[float, Field(ge=0, le=1)] | None = None  # share on captures
    shadow: Annotated[float, Field(ge=0, le=1)] = Light.shadow
    softness: Annotated[float, Field(ge=0, le=1)] = Light.softness
    shade: Annotated[float, Field(ge=0, le=1)] = Light.shade
    contact: Annotated[float, Field(ge=0, le=1)] = Light.contact

    def light(self) -> Light:
        """Return the light of preset "paper"."""
        names = ("shadow", "softness", "shade", "contact")
        values = {name: getattr(self, name) for name in names}
        return Light(self.direction or Light.direction, **values)


class LiquidSettings(RenderTable):
    """Liquids in the studio, which draws their surfaces."""

    cells_per_spacing: Annotated[float, Field(ge=1, le=4)] = 2.5  # of the density field
    # [1/m]; default: by opacity
    scattering_coefficient: Annotated[float, Field(ge=0)] | None = None
    clip_at_walls: bool = True  # whether the domain's walls cut the surface flat
    refractive_index: Annotated[float, Field(ge=1.0, le=3.0)] = 1.333
    # [m] distance after which white light has the liquid's color; default: 2/3 of the view
    absorption_length: Annotated[float, Field(gt=0)] | None = None
    highlight: Annotated[float, Field(ge=0, le=100)] = 2.0
    environment: EnvironmentSettings = EnvironmentSettings()


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    """Require [low, high] with 1 <= low <= high <= 20."""
    if not 1.0 <= value[0] <= value[1] <= 20.0:
        raise ValueError("must be two numbers [low, high] with 1 <= low <= high <= 20")
    return value


class LookSettings(RenderTable):
    """Appearance of Gaussians; None: the value of the scene (vgmpi/scene/sections.py)."""

    preset: Literal["studio", "paper"] = "studio"  # paper: plain Gaussians
    # of sand or snow
    grains_per_particle: Annotated[int, Field(strict=True, ge=1, le=64)] = 16
    tear: Annotated[tuple[float, float], AfterValidator(_ascending)] = (1.8, 4.5)  # [spacings]
    dust: Annotated[float, Field(ge=0, le=1)] = 0.03  # opacity of dust
    foam: Annotated[float, Field(ge=0, le=1)] = 0.8  # largest share of white
    # mode "step" is set by the run, which then transfers colors itself
    color_transfer: Literal["off", "frame", "relax"] | None = None
    color_relaxation_time: Annotated[float, Field(gt=0)] | None = None  # [s]
    color_sh_degree: Annotated[int, Field(strict=True, ge=0, le=3)] | None = None
    color_objects: tuple[str, ...] | None = None
    covariance: Literal["evolve", "fixed"] = "evolve"  # fixed: shapes at rest
    rotate_sh: bool = True  # whether colors rotate with solids
    opacity: Literal["scaled", "fixed"] = "scaled"  # fixed: no opacity_scale
    # of fluids, sand and snow: balls of a particle's volume, or of a Gaussian's own size;
    # default: none if F is known, else volume
    covariance_normalization: Literal["volume", "radius", "none"] | None = None
    opacity_scale: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}  # by object name
    # by object name: largest relative change of brightness of a particle
    brightness_jitter: dict[str, Annotated[float, Field(ge=0, le=1)]] = {}

    def colors(self) -> dict[str, Any]:
        """Return the settings of color transfer by the names of the scene's [appearance]."""
        return {k: v for k, v in self if k.startswith("color_") and v is not None}
