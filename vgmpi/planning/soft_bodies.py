"""Bodies that are too soft, or too fast, for contact with the walls of the domain.

Contact pushes a body with a known surface by an elastic layer of two and a half cells
(kernels/grid/contact_impulses.py). A pressure of a tenth of the modulus uses it up, and beyond that
the nodes inside draw the body into the wall. Such bodies meet separate walls as grains do, by the
mirror image of what presses on them (kernels/wall_boundary.py).
"""

import math

import numpy as np

from vgmpi.materials.material import law_function
from vgmpi.scene.scene import Scene

from .phases_and_groups import GroupPlan, PhasePlan

LAYER_CELLS = 2.5  # [cells] thickness of the layer
# [cells] overlap under the weight of all bodies, on the square of the cube root of a body's volume
MAX_RESTING_OVERLAP = 0.035
MAX_IMPACT = 0.1  # [-] speed at a wall over the wave speed: the part of the modulus that it takes


def with_soft_bodies(
    scene: Scene, phases: tuple[PhasePlan, ...], groups: tuple[GroupPlan, ...],
    volume: list[float], center: list[list[float]],
) -> tuple[PhasePlan, ...]:  # fmt: skip
    """Return the phases, of which those are marked that are too soft for contact with walls.

    Args:
        scene: The scene.
        phases, groups: Phases and groups of the scene.
        volume: Volume of each object and inlet [m3].
        center: Center of each [m].
    """
    if scene.accuracy.keeps or all(kind != "separate" for kind, _ in scene.walls_of_solids):
        return phases
    keys = scene.domain.gravity_keyframes or ()
    pulls = [scene.domain.gravity, *(key.gravity for key in keys)]
    weight = max(math.hypot(*pull) for pull in pulls) * math.fsum(
        volume[k] * scene.material[entity.material].bulk_density
        for k, entity in enumerate(scene.things)
        if entity.material is not None and scene.material[entity.material].family != "fluid"
    )
    return tuple(
        phase._replace(is_soft=_is_soft(scene, phase, p, groups, weight, pulls, volume, center))
        if phase.surface
        else phase
        for p, phase in enumerate(phases)
    )


def _is_soft(scene, phase, p, groups, weight, pulls, volume, center) -> bool:
    """Return whether weight [N] or speed is too much for the contact of a phase with walls."""
    own = [group for group in groups if group.phase == p]
    waves = [float(law_function(group.law, "wave_speed2")(group.law, group.rest)) for group in own]
    modulus = min(group.density * wave for group, wave in zip(own, waves, strict=True))
    size = math.cbrt(math.fsum(volume[k] for k in phase.objects))
    if not (size > 0.0 and modulus > 0.0):
        return True
    if LAYER_CELLS * weight / size**2 > MAX_RESTING_OVERLAP * modulus:
        return True
    speed2 = max(_speed_squared(scene, k, pulls, size, center[k]) for k in phase.objects)
    return speed2 > MAX_IMPACT**2 * min(waves)


def _speed_squared(scene, k, pulls, size, center) -> float:
    """Return the squared speed with which an object may meet a wall below it [m2/s2]."""
    fastest = 0.0
    for pull in pulls:
        axis = int(np.argmax(np.abs(pull)))
        wall = 0.0 if pull[axis] < 0 else scene.domain.size[axis]
        height = max(abs(center[axis] - wall) - 0.5 * size, 0.0)
        fastest = max(fastest, 2.0 * abs(pull[axis]) * height)
    return fastest + scene.things[k].speed ** 2
