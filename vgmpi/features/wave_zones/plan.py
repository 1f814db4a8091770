"""Plan of wave zones: regular waves of small amplitude, and where velocities relax to theirs."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from vgmpi.planning.feature_plan import FeaturePlan
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

from .feature import WaveZone, wave_number

MIN_HEIGHT_CELLS = 1.0  # [cells] height of waves below which the plan warns


class ZonePlan(NamedTuple):
    """Zone with its wave, in SI units."""

    zone: WaveZone
    number: float  # [rad/m] wave number

    @property
    def frequency(self) -> float:
        """Return the angular frequency [rad/s]."""
        return 2.0 * math.pi / self.zone.period

    @property
    def max_speed(self) -> float:
        """Return the largest speed of the water in the waves [m/s]."""
        crest = math.exp(self.number * self.zone.height)
        return self.zone.height * self.frequency * crest / -math.expm1(-2.0 * self.reach)

    @property
    def reach(self) -> float:
        """Return the wave number times the depth."""
        return self.number * self.zone.depth

    def amplitude(self, time: float) -> float:
        """Return the amplitude of the waves at a time [m], with their growth from 0."""
        ramp = self.zone.period if self.zone.ramp_time is None else self.zone.ramp_time
        age = time - self.zone.start_time
        if age <= 0.0:
            return 0.0
        growth = 1.0 if age >= ramp else 0.5 - 0.5 * math.cos(math.pi * age / ramp)
        return 0.5 * self.zone.height * growth


class WaveZonesPlan(FeaturePlan):
    """Wave zones of a run."""

    name = "wave_zones"

    def __init__(self, zones: tuple[ZonePlan, ...]):
        """Take the zones."""
        self.zones = zones
        self.drives_motion = any(each.zone.height for each in zones)

    def report_lines(self, plan: Plan) -> list[str]:
        """Return a line for each zone.

        Args:
            plan: Plan of the run.
        """
        lines = []
        for each in self.zones:
            wave = 2.0 * math.pi / each.number
            purpose = (
                f"makes waves {each.zone.height:.4g} m high" if each.zone.height else "is a beach"
            )
            lines.append(
                f"  wave zone   {escape_control_characters(each.zone.name)} {purpose}, wavelength"
                f" {wave:.4g} m, {wave / plan.dx:.1f} cells; its length {each.zone.length:.4g} m"
            )
        return lines

    def warning_lines(self, plan: Plan) -> list[str]:
        """Return a line on zones without liquids, and on waves that the cells do not resolve.

        Args:
            plan: Plan of the run.
        """
        lines = []
        if not any(group.is_liquid for group in plan.groups):
            lines.append("wave_zone: the scene has no liquid for it to act on")
        for each in self.zones:
            cells = each.zone.height / plan.dx
            if 0.0 < cells < MIN_HEIGHT_CELLS:
                lines.append(
                    f"wave_zone.{each.zone.name}.height: {cells:.2g} cells; waves lower than"
                    f" {MIN_HEIGHT_CELLS:g} cell are lost in the noise of the surface"
                )
        return lines

    def start(self, context: Any) -> Any:
        """Return the zones as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import WaveZones  # it compiles

        return WaveZones(self.zones, context)


def plan_wave_zones(zones: Sequence[WaveZone], scene: Scene) -> WaveZonesPlan:
    """Return the plan of the zones of a scene.

    Args:
        zones: The zones.
        scene: The scene.
    """
    gravity = -scene.domain.gravity[2]
    return WaveZonesPlan(
        tuple(ZonePlan(zone, wave_number(zone.period, zone.depth, gravity)) for zone in zones)
    )
