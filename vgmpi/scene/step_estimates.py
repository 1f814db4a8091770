"""Estimates of time steps that follow from a scene alone, before it is planned."""

import math
from typing import Any

from vgmpi.materials.material import law_function

from .gravity import gravity_keys
from .scene import Scene

# [-] Fastest particle of a liquid over its `max_speed`, mean over a run: 0.98, 1.40, 1.40 in
# two_liquids, driftwood and water_wheel (the steps that their runs print)
FASTEST_LIQUID = 1.2
RIGID_STEPS = 10.0  # [-] steps of rigid bodies alone in the time in which a drop falls `cfl` cells


def squared_wave_speed(material: Any) -> float:
    """Return the squared speed of compression waves in a material at rest [m2/s2]."""
    law = material.law()
    reference = tuple(v for values in material.carries.values() for v in values)
    return law_function(law, "wave_speed2")(law, reference)


def falling_rate(scene: Scene) -> float:
    """Return the least 1 / dt [1/s] that gravity asks for where no waves bound the step, else 0.

    With particles a drop at rest falls by less than `cfl` cells in a step. In a scene of
    rigid bodies alone a step is RIGID_STEPS times shorter, for the error of their way: it is half
    the way of a step. Without gravity the time between two frames takes the place of this one.
    """
    if not scene.is_free_of_waves and scene.has_particles:
        return 0.0
    keys = [scene.domain.gravity, *(gravity for _, gravity in gravity_keys(scene.domain))]
    gravity = max(math.sqrt(sum(g * g for g in key)) for key in keys)
    falling = math.sqrt(2.0 * gravity / scene.domain.cell) / scene.courant_number
    falling = falling or (scene.time.frames - 1) / scene.time.end
    return falling if scene.has_particles else RIGID_STEPS * falling


def expected_speed(scene: Scene, liquid: Any, start_speed: float) -> float:
    """Return the speed [m/s] that is expected of a liquid.

    It is that for which it is stiff enough, `max_speed` or the speed that its depth gives, but no
    more than that of what falls through the domain.

    Args:
        scene: The scene.
        liquid: Its material.
        start_speed: Largest speed of anything at the start [m/s].
    """
    domain = scene.domain
    drop = sum(abs(g) * edge for g, edge in zip(domain.gravity, domain.size, strict=True))
    fall = math.sqrt(start_speed**2 + 2.0 * drop) or math.inf
    modulus = liquid.tait_coefficient * liquid.tait_exponent
    return min(FASTEST_LIQUID * math.sqrt(liquid.max_compression * modulus / liquid.density), fall)


def motion_rate(scene: Scene, solid_cells: float) -> float:
    """Return the 1 / dt [1/s] that is expected of waves, motion and gravity, without viscosity.

    Prescribed motions, and the speeds that solids reach, are left out.

    Args:
        scene: The scene, which says how its pressure is found.
        solid_cells: Cells that a wave of a solid goes in a step, if the grid finds the pressure.
    """
    cell, courant = scene.domain.cell, scene.courant_number
    start_speed = max((obj.speed for obj in scene.object), default=0.0)
    liquid_speed = math.inf if scene.particle_sources else start_speed  # a jet is no falling drop
    rates = [falling_rate(scene)]
    for material in scene.used_materials.values():
        wave = math.sqrt(squared_wave_speed(material))
        if material.family == "fluid":
            speed = expected_speed(scene, material, liquid_speed)
            wave = 0.0 if scene.is_free_of_waves else wave
            rates.append((wave + speed) / (courant * cell))
            rates.append(speed / (scene.max_cells_per_step * cell))
        elif scene.is_free_of_waves:
            rates.append(wave * math.sqrt(material.stiffening) / (solid_cells * cell))
        else:
            rates.append((wave + start_speed) / (courant * cell))
    return max(rates)


def viscous_rate(scene: Scene) -> float:
    """Return the 1 / dt [1/s] that the viscosity of liquids asks for if it acts explicitly."""
    viscosities = [material.kinematic_viscosity for material in scene.used_materials.values()]
    return 6.0 * max(viscosities, default=0.0) / scene.domain.cell**2
