"""Which bodies exchange colours where these travel through the grid, and which phases do so with
every step: `colour_transfer = "step"`.
"""

from typing import NamedTuple

import numpy as np

from ..couplings.base import MIXING
from ..gaussians.sh import COEFFICIENTS
from ..scene.scene import Scene
from .sharing import connected


class Exchange(NamedTuple):
    """Colours that travel with every step, as spherical harmonics.

    Particles carry the difference from `least`, so that equal colours stay exactly equal.
    """

    set_of: np.ndarray  # (phases,) those of one number exchange among themselves; -1: none
    coefficients: np.ndarray  # (phases,) of each particle; 0 where none travel
    least: np.ndarray  # (phases, K, 3) what is subtracted: the least of the set's
    span: np.ndarray  # (phases, K) largest of what is left


def colour_sets(scene: Scene) -> list[int | None]:
    """For each object of a scene the number of the set in which colours may travel: bodies of one
    phase, and of fluids that mix, are in one set. None for scenery.

    Files tell it (`colour_set` of an object), so that a renderer need not know of couplings.
    """
    phase_of = [scene.phase_of(thing) for thing in scene.things]
    names = sorted({name for name in phase_of if name is not None})
    number = {name: k for k, name in enumerate(names)}
    of: dict[str, set[int]] = {}
    for thing, name in zip(scene.things, phase_of, strict=True):
        if name is not None:
            of.setdefault(str(thing.material), set()).add(number[name])
    pairs = [(k, k) for k in range(len(names))]  # each with itself
    for coupling in scene.coupling:
        if coupling.rule == MIXING:
            one, other = (of.get(name, ()) for name in coupling.between)
            pairs += [(a, b) for a in one for b in other]
    found = connected(len(names), pairs)
    return [None if name is None else int(found[number[name]]) for name in phase_of]


def exchange(scene: Scene, phases, shades: np.ndarray | None) -> Exchange | None:
    """The Exchange of a scene, or None where no colour travels with the steps.

    phases: groups.PhasePlan of each; shades: (objects, 2, K, 3) least and largest of each
    coefficient of an object's colours, nan for objects without particles, or None if not known. A
    set of one colour takes no part."""
    if scene.appearance.colour_transfer != "step":
        return None
    asked = _asked(scene)
    most = COEFFICIENTS[scene.appearance.colour_degree]
    if shades is None:
        shades = np.zeros((len(scene.things), 2, most, 3)) + np.array([0.0, 1.0])[:, None, None]
    shades = shades[:, :, :most]
    set_of = np.full(len(phases), -1)
    count = np.zeros(len(phases), np.int64)
    least = np.zeros((len(phases), *shades.shape[2:]))
    span = np.zeros(least.shape[:2])
    sets: dict[int | None, list[int]] = {}
    meets = colour_sets(scene)
    for k, phase in enumerate(phases):
        if asked & set(phase.objects):
            sets.setdefault(meets[phase.objects[0]], []).append(k)
    for number, members in enumerate(sets.values()):
        # the higher degrees of a body that turns are told in axes that turn with it
        turns = any("solid" in phases[k].families for k in members)
        every = [shades[m] for k in members for m in phases[k].objects]
        found = np.array([one for one in every if not np.isnan(one).any()])
        found = found[:, :, : 1 if turns else most]
        if not len(found) or (found == found[0, 0]).all():
            continue
        for k in members:
            set_of[k], count[k] = number, found.shape[2]
            least[k, : found.shape[2]] = found.min(axis=(0, 1))
            span[k, : found.shape[2]] = np.ptp(found, axis=(0, 1)).max(-1)
    return Exchange(set_of, count, least, span) if count.any() else None


def _asked(scene: Scene) -> set[int]:
    """Rows of the objects whose colours travel."""
    names = scene.appearance.colour_bodies
    found = set()
    for k, thing in enumerate(scene.things):
        if thing.material:
            fluid = scene.material[thing.material].family == "fluid"
            if fluid if names is None else thing.name in names:
                found.add(k)
    return found


def shades(count: int, thing, sh) -> np.ndarray:
    """Least and largest of each coefficient of the colours of `count` objects: (count, 2, K, 3),
    nan for those without particles.

    thing: (n,) object of each particle; sh: (n, K, 3).
    """
    thing, sh = np.asarray(thing), np.asarray(sh, np.float64)
    out = np.full((count, 2, *sh.shape[1:]), np.nan)
    for k in range(count):
        mine = sh[thing == k]
        if len(mine):
            out[k] = mine.min(axis=0), mine.max(axis=0)
    return out
