"""Which phases exchange colours through the grid with every step: `colour_transfer = "step"`."""

from typing import NamedTuple

import numpy as np

from ..gaussians.sh import COEFFICIENTS
from ..scene.scene import Scene


class Exchange(NamedTuple):
    """Colours that travel with every step, as spherical harmonics.

    Particles carry the difference from `least`, so that equal colours stay exactly equal.
    """

    set_of: np.ndarray  # (phases,) those of one number exchange among themselves; -1: none
    coefficients: np.ndarray  # (phases,) of each particle; 0 where none travel
    least: np.ndarray  # (phases, K, 3) what is subtracted: the least of the set's


def exchange(
    scene: Scene, phases, mix: np.ndarray | None, shades: np.ndarray | None
) -> Exchange | None:
    """The Exchange of a scene, or None where no colour travels with the steps.

    phases: plan.PhasePlan of each; mix: (phases,) number of the fluids that mix, -1 for others;
    shades: (objects, 2, K, 3) least and largest of each coefficient of an object's colours, nan for
    objects without particles, or None if not known. A set of one colour takes no part."""
    if scene.appearance.colour_transfer != "step":
        return None
    asked = _asked(scene)
    most = COEFFICIENTS[scene.appearance.colour_degree]
    if shades is None:
        shades = np.zeros((len(scene.object), 2, most, 3)) + np.array([0.0, 1.0])[:, None, None]
    shades = shades[:, :, :most]
    set_of = np.full(len(phases), -1)
    count = np.zeros(len(phases), np.int64)
    least = np.zeros((len(phases), *shades.shape[2:]))
    sets: dict[tuple, list[int]] = {}
    for k, phase in enumerate(phases):
        if asked & set(phase.objects):
            group = -1 if mix is None else mix[k]
            sets.setdefault(("mix", group) if group >= 0 else ("own", k), []).append(k)
    for number, members in enumerate(sets.values()):
        # the higher degrees of a body that turns are told in axes that turn with it
        turns = any(phases[k].family == "solid" for k in members)
        every = [shades[m] for k in members for m in phases[k].objects]
        found = np.array([one for one in every if not np.isnan(one).any()])
        found = found[:, :, : 1 if turns else most]
        if not len(found) or (found == found[0, 0]).all():
            continue
        for k in members:
            set_of[k], count[k] = number, found.shape[2]
            least[k, : found.shape[2]] = found.min(axis=(0, 1))
    return Exchange(set_of, count, least) if count.any() else None


def _asked(scene: Scene) -> set[int]:
    """Rows of the objects whose colours travel."""
    names = scene.appearance.colour_bodies
    found = set()
    for k, thing in enumerate(scene.object):
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
