"""Wave zones: liquids whose velocities relax to those of regular waves, or to rest (coupling.py).

See [[wave_zone]] in docs/reference/scene.md and docs/explanation/wave-zones.md.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, model_validator

from vgmpi.runtime.config.schema import Length, Point, Positive, Quantity, StrictModel
from vgmpi.scene.objects import checked_name
from vgmpi.scene.probes import refuse_balance
from vgmpi.scene.scene_feature import Errors, SceneFeature, SceneTables, TableList

# axis of each face, and the direction in which waves leave it for the domain
OUTER_FACES = {"west": (0, 1), "east": (0, -1), "south": (1, 1), "north": (1, -1)}
# [-] default rate of relaxation times period, of zones that make waves and of beaches: the linear
# problem of a zone one wavelength long makes 1.01 of the height, and returns 0.04 of a wave
MAKER_RATE, BEACH_RATE = 24.0, 12.0
MAX_STEEPNESS = 0.142  # [-] height over wavelength of the steepest wave in deep water (Miche 1944)


class WaveZone(StrictModel):
    """Zone of liquids whose velocities relax to those of regular waves, or to rest.

    With a `height` it makes waves, which run from its outer face into the domain; without one it is
    a beach, which takes up the waves that arrive. Waves of a scene leave a zone that makes waves,
    too, as far as they differ from these.
    """

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name"""
    box: tuple[Point, Point]
    """two opposite corners. A zone should be as long as the longest wave"""
    outer: Literal["west", "east", "south", "north"]
    """outer face of the box, where the relaxation is strongest: at low x, high x, low y, high y"""
    period: Annotated[float, Quantity("s", gt=0)]
    """period of the waves that it makes, or of the longest ones that it takes up"""
    level: Length
    """z of the water's surface at rest"""
    depth: Positive
    """depth of the water at rest"""
    height: Annotated[float, Quantity("m", ge=0)] = 0.0
    """height of the waves, from trough to crest; 0: the zone takes up waves"""
    start_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time at which the waves begin; before, the zone takes up waves"""
    ramp_time: Annotated[float, Quantity("s", ge=0)] | None = None
    """time in which the waves grow from 0, as half a cosine; default: one period"""
    rate: Annotated[float, Quantity("1/s", gt=0)] | None = None
    """rate of relaxation at the outer face; default: 24 over the period, for a beach 12"""

    @model_validator(mode="after")
    def _has_extent(self) -> "WaveZone":
        if any(low >= high for low, high in zip(*self.corners)):
            name = "xyz"[self.axis]
            raise ValueError(f"box must have an extent along each axis, {name} above all")
        return self

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the lowest and the highest corner of the box [m]."""
        rows = list(zip(*self.box))
        return tuple(map(min, rows)), tuple(map(max, rows))

    @property
    def axis(self) -> int:
        """Return the axis along which its waves run, 0 or 1."""
        return OUTER_FACES[self.outer][0]

    @property
    def direction(self) -> int:
        """Return whether they run towards higher coordinates, 1, or lower ones, -1."""
        return OUTER_FACES[self.outer][1]

    @property
    def outer_place(self) -> float:
        """Return the coordinate [m] of the outer face."""
        return self.corners[0 if self.direction > 0 else 1][self.axis]

    @property
    def length(self) -> float:
        """Return its length [m] along the way of its waves."""
        low, high = self.corners
        return high[self.axis] - low[self.axis]

    @property
    def relaxation_rate(self) -> float:
        """Return the rate of relaxation at the outer face [1/s]."""
        default = (MAKER_RATE if self.height else BEACH_RATE) / self.period
        return default if self.rate is None else self.rate


def wave_number(period: float, depth: float, gravity: float) -> float:
    """Return the wave number k [rad/m] with (2 pi / period)^2 = g k tanh(k depth).

    Args:
        period: Period [s].
        depth: Depth [m].
        gravity: Strength of gravity [m/s2].

    References:
        Dean and Dalrymple (1991). Water wave mechanics for engineers and scientists, section 3.4.
    """
    deep_number = (2.0 * math.pi / period) ** 2 / gravity
    k = max(deep_number, math.sqrt(deep_number / depth))
    for _ in range(50):
        slope = math.tanh(k * depth) + k * depth / math.cosh(min(k * depth, 300.0)) ** 2
        k -= (k * math.tanh(k * depth) - deep_number) / slope
    return k


def max_height(period: float, depth: float, gravity: float) -> float:
    """Return the height [m] at which regular waves break.

    Args:
        period: Period [s].
        depth: Depth [m].
        gravity: Strength of gravity [m/s2].

    References:
        Miche (1944). Mouvements ondulatoires de la mer en profondeur constante ou decroissante.
    """
    k = wave_number(period, depth, gravity)
    return MAX_STEEPNESS * 2.0 * math.pi / k * math.tanh(k * depth)


class WaveZones(SceneFeature):
    """Wave zones in the tables of a scene."""

    name, title = "wave_zones", "wave zones"
    lists = {"wave_zone": TableList({"": WaveZone})}
    missing_engines = ("cuda",)
    suits_implicit_pressure = True

    def check_list(self, name: str, raw: list[dict], tables: SceneTables) -> Errors:
        """Return the errors of the wave zones.

        Args:
            name, raw, tables: See `SceneFeature.check_list`.
        """
        domain, zones = tables.sections.get("domain"), enumerate(tables.lists[name])
        valid = [(k, zone) for k, zone in zones if zone is not None]
        if domain is None or not valid:
            return []
        x, y, z = domain.gravity
        if x or y or z >= 0 or domain.gravity_keyframes or domain.gravity_ramp_time:
            message = "must be constant and along -z: the waves of a wave_zone need it"
            return [(("domain", "gravity"), message)]
        return [
            ((name, k, key), message)
            for k, zone in valid
            for key, message in _check_zone(zone, domain.size, -z)
        ]

    def check_probes(self, probes: list, tables: SceneTables) -> Errors:
        """Return the errors of probes whose balance of momentum lacks the force of a zone.

        Args:
            probes, tables: See `SceneFeature.check_probes`.
        """
        if not any(zone is not None for zone in tables.lists["wave_zone"]):
            return []
        message = "is not for scenes with a wave zone: its force is no part of the balance"
        return refuse_balance(probes, message)

    def plan(self, draft: Any, prepared: Any) -> tuple[Any, Any]:
        """Return the plan of the zones, or None without any, and the draft as it is.

        Args:
            draft, prepared: See `SceneFeature.plan`.
        """
        zones = draft.scene.lists["wave_zone"]
        if not zones:
            return None, draft
        from .plan import plan_wave_zones

        return plan_wave_zones(zones, draft.scene), draft


def _check_zone(zone: WaveZone, size: tuple, gravity: float) -> list[tuple[str, str]]:
    """Return (key, message) of what is wrong with a zone.

    Args:
        zone: The zone.
        size: Size of the domain, shape (3,) [m].
        gravity: Strength of gravity [m/s2].
    """
    errors = []
    for a, (low, high) in enumerate(zip(*zone.corners)):
        if high <= 0.0 or low >= size[a]:
            allowed = f"0 to {size[a]:g} m along {'xyz'[a]}"
            errors.append(("box", f"is outside of the domain, {allowed}"))
    outer, length = zone.outer_place, size[zone.axis]
    if not -1e-6 * length <= outer <= (1 + 1e-6) * length:
        message = f"the face is at {outer:g} m, outside of the domain: no wave would be whole"
        errors.append(("outer", message))
    if not zone.corners[0][2] < zone.level <= size[2]:
        message = f"must be above the lowest corner of the box and at most {size[2]:g} m"
        errors.append(("level", message))
    elif zone.depth > zone.level * (1 + 1e-6):
        message = f"reaches below the domain: at most {zone.level:g} m, as the level is"
        errors.append(("depth", message))
    breaking = max_height(zone.period, zone.depth, gravity)
    if zone.height >= breaking:
        message = f"waves of this period and depth break at {breaking:.3g} m; must be less"
        errors.append(("height", message))
    return errors


FEATURE = WaveZones()
