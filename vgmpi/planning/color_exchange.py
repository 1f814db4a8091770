"""Color exchange between bodies: who may exchange, and the scaling of transferred coefficients.

Colors that travel through the grid do so with every step if `color_transfer = "step"`.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.spherical_harmonics import COEFFICIENTS
from vgmpi.materials.couplings.interaction import MIXING
from vgmpi.scene.scene import Scene

from .interaction_rules import connected_sets


class ColorExchange(NamedTuple):
    """Colors that are transferred in every step, as spherical harmonics.

    Particles carry the difference from `minimum`, so that equal colors stay exactly equal.
    """

    set_of: np.ndarray  # (phases,) exchange set; phases of one set exchange; -1: none
    coefficients: np.ndarray  # (phases,) coefficients per particle; 0: none travel
    minimum: np.ndarray  # (phases, K, 3) minimum over the set, which is subtracted
    span: np.ndarray  # (phases, K) largest remaining value


def color_sets(scene: Scene) -> list[int | None]:
    """Return the number of the set in which the colors of each object may travel.

    Bodies of one phase, and of fluids that mix, are in one set. Scenery has None. Files store the
    number (`color_group` of an object), so that a renderer need not know of couplings.
    """
    phase_of = [scene.phase_of(entity) for entity in scene.entities]
    names = sorted({name for name in phase_of if name is not None})
    number = {name: k for k, name in enumerate(names)}
    numbers_of: dict[str, set[int]] = {}
    for entity, name in zip(scene.entities, phase_of, strict=True):
        if name is not None:
            numbers_of.setdefault(str(entity.material), set()).add(number[name])
    pairs = [(k, k) for k in range(len(names))]  # every phase is paired with itself
    for coupling in scene.coupling:
        if coupling.rule == MIXING:
            first, second = (numbers_of.get(name, ()) for name in coupling.between)
            pairs += [(a, b) for a in first for b in second]
    set_of = connected_sets(len(names), pairs)
    return [None if name is None else int(set_of[number[name]]) for name in phase_of]


def color_exchange(scene: Scene, phases, shades: np.ndarray | None) -> ColorExchange | None:
    """Return the color exchange of a scene, or None if no color travels with the steps.

    A set of a single color takes no part.

    Args:
        scene: The scene.
        phases: `PhasePlan` of each phase.
        shades: Minimum and maximum of each color coefficient by object, shape (objects, 2, K, 3),
            NaN for objects without particles; None if unknown.
    """
    if scene.appearance.color_transfer != "step":
        return None
    travelling = _travelling_objects(scene)
    width = COEFFICIENTS[scene.appearance.color_sh_degree]
    if shades is None:
        shades = np.zeros((len(scene.entities), 2, width, 3)) + np.array([0.0, 1.0])[:, None, None]
    shades = shades[:, :, :width]
    set_of = np.full(len(phases), -1)
    count = np.zeros(len(phases), np.int64)
    minimum = np.zeros((len(phases), *shades.shape[2:]))
    span = np.zeros(minimum.shape[:2])
    sets: dict[int | None, list[int]] = {}
    meets = color_sets(scene)
    for k, phase in enumerate(phases):
        if travelling & set(phase.objects):
            sets.setdefault(meets[phase.objects[0]], []).append(k)
    for number, members in enumerate(sets.values()):
        # The higher degrees of a rotating body are expressed in axes that rotate with it.
        turns = any("solid" in phases[k].families for k in members)
        every = [shades[m] for k in members for m in phases[k].objects]
        ranges = np.array([values for values in every if not np.isnan(values).any()])
        ranges = ranges[:, :, : 1 if turns else width]
        if not len(ranges) or (ranges == ranges[0, 0]).all():
            continue
        for k in members:
            set_of[k], count[k] = number, ranges.shape[2]
            minimum[k, : ranges.shape[2]] = ranges.min(axis=(0, 1))
            span[k, : ranges.shape[2]] = np.ptp(ranges, axis=(0, 1)).max(-1)
    return ColorExchange(set_of, count, minimum, span) if count.any() else None


def _travelling_objects(scene: Scene) -> set[int]:
    """Return the rows of the objects whose colors travel."""
    names = scene.appearance.color_objects
    rows = set()
    for k, entity in enumerate(scene.entities):
        if entity.material:
            fluid = scene.material[entity.material].family == "fluid"
            if fluid if names is None else entity.name in names:
                rows.add(k)
    return rows


def coefficient_ranges(count: int, object_of, sh) -> np.ndarray:
    """Return the minimum and maximum of each color coefficient, by object.

    Args:
        count: Number of objects.
        object_of: Object of each particle, shape (n,).
        sh: Spherical-harmonic coefficients, shape (n, K, 3).

    Returns:
        Shape (count, 2, K, 3), NaN for objects without particles.
    """
    object_of, sh = np.asarray(object_of), np.asarray(sh, np.float64)
    out = np.full((count, 2, *sh.shape[1:]), np.nan)
    for k in range(count):
        mine = sh[object_of == k]
        if len(mine):
            out[k] = mine.min(axis=0), mine.max(axis=0)
    return out
