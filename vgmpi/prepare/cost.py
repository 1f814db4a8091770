"""What a scene's objects cost at least, worked out before they are made.

All numbers are bounds from below, so that nothing is refused that would have fitted: objects are
counted by their boxes first, and by points thrown into them where their boxes do not fit.
"""

from collections.abc import Callable

import numpy as np

from vgmpi import room
from vgmpi.prepare import shapes
from vgmpi.prepare.place import (
    Placement,
    PlacementError,
    check_inside,
    corners,
    place,
    where_placed,
)
from vgmpi.scene.objects import SIZES, Object
from vgmpi.scene.scene import Scene

# bytes of one with a plain colour: while its object is made, and when all are joined
MADE = {"body": 108, "scenery": 100}
JOINED = {"body": 108, "scenery": 68}
LATTICE = 24  # bytes of a place on a lattice
MOST_PLACES = 2.0**38  # that are looked at for particles, one by one: some days
FARTHEST = 2.0**52  # spacings from the origin to a particle: numbers are no finer there
_THROWN = 1 << 16  # points
_SURE = 4.0  # standard deviations of their count by which it is lowered
_DEEP = 0.02  # of the box's size: the deepest layer below a surface that is looked at


def afford(scene: Scene) -> None:
    """Raises SceneError, one line, where particles of shapes cannot fit into the memory."""
    most, have = {}, room.free(swap=True)
    for k, thing in enumerate(scene.object):
        if (found := _box(scene, thing)) is not None:
            most[k] = shapes.span(*found[1:], spacing_of(scene, thing))
    each = {role: MADE[role] + JOINED[role] for role in MADE}
    needed = {k: n * each[scene.object[k].role] for k, n in most.items()}
    if not have or sum(needed.values()) <= have:
        return
    # of many objects those that hardly count are left out: each takes a moment to look at
    large = [k for k in most if needed[k] > 1e-3 * have]
    fits(scene, {k: least(scene, scene.object[k]) for k in large}, each)


def afford_inside(scene: Scene, k: int, places: float, count: Callable[[float], int]) -> None:
    """Raises SceneError, one line, where what fills object k cannot fit into the memory.

    places: on the lattice in its box. count: how many of those of a lattice of a spacing [m] are
    inside, of which a coarse one is tried where the box does not fit.
    """
    each = {"body": MADE["body"] + JOINED["body"], "scenery": LATTICE}
    have = room.free(swap=True)
    if have and places * each[scene.object[k].role] > have:
        coarser = (places / _THROWN) ** (1 / 3)
        found = count(coarser * spacing_of(scene, scene.object[k]))
        surely = max(0.0, found - _SURE * np.sqrt(found))
        fits(scene, {k: surely * coarser**3}, each)


def fits(scene: Scene, count: dict[int, float], each: dict[str, int]) -> None:
    """Raises SceneError, one line with the key that drives it, where particles do not fit.

    count: particles of objects by their rows. each: bytes of one, by the object's role.
    """
    needed = {k: n * each[scene.object[k].role] for k, n in count.items()}
    if not needed:
        return
    k = max(needed, key=lambda k: needed[k])
    thing, what = scene.object[k], "particles" if scene.object[k].role == "body" else "Gaussians"
    said = f"makes at least {count[k]:.3g} {what} of '{thing.name}'"
    said = f"{scene.domain.cell:g} m {said}" if what == "particles" else said
    others = sum(count.values()) - count[k]
    more = f", with all others {others + count[k]:.3g}" if others else ""
    try:
        room.check(sum(needed.values()), f"{said}, {spacing_of(scene, thing):g} m apart{more}: at"
                   " least")  # fmt: skip
    except room.TooLarge as error:
        raise scene.error([(key(scene, k), str(error))]) from None


def key(scene: Scene, k: int) -> tuple:
    """The key of the scene that drives what object k costs: bodies lie in the domain, so that it is
    their cells; scenery may be of any size."""
    thing = scene.object[k]
    if thing.role == "body":
        return ("domain", "cell")
    return ("object", k, sized(thing))


def sized(thing: Object) -> str:
    """The key that says how large an object is."""
    return next(name for name in (*SIZES, thing.source) if getattr(thing, name) is not None)


def within_numbers(scene: Scene, thing: Object, low: np.ndarray, high: np.ndarray) -> None:
    """Raises PlacementError where an object is so large or far away, or so small, that places of
    particles in it are no numbers. low, high: its corners (3,) [m]."""
    most = FARTHEST * spacing_of(scene, thing)
    if not (np.abs([low, high]) <= most).all():  # also of what is not a number
        said = f"reaches {np.abs([low, high]).max():.3g} m from the origin; at most {most:.3g} m"
        raise PlacementError(where_placed(thing), f"{said} are possible with cells of"
                             f" {scene.domain.cell:g} m")  # fmt: skip


def looked_at(places: float) -> None:
    """Raises TooLarge where too many places are looked at for particles."""
    if not places <= MOST_PLACES:
        said = f"{places:.3g} places for particles would have to be looked at"
        raise room.TooLarge(f"{said}; at most {MOST_PLACES:.3g} are")


def spacing_of(scene: Scene, thing: Object) -> float:
    """Distance [m] of particles on the lattice."""
    return scene.domain.cell / round(thing.particles_per_cell ** (1 / 3))


def least(scene: Scene, thing: Object) -> float:
    """How many particles a shape makes at least.

    Points thrown into its box say how much of it is inside, or close below the surface for scenery,
    which is a skin: of layers of several depths the one that tells most, since points may miss a
    thin one and a thick one reaches through the body.
    """
    at, low, high = _box(scene, thing)
    draw = np.random.Generator(np.random.Philox(1)).random((_THROWN, 3))
    deep = -at.scale * shapes.distance(thing.shape, at.own(low + draw * (high - low)))
    spacing, volume = spacing_of(scene, thing), float(np.prod(high - low))
    layers = [1.0]  # depths in spacings
    while thing.role == "scenery" and layers[-1] * spacing < _DEEP * volume ** (1 / 3):
        layers.append(2.0 * layers[-1])
    found = []
    for layer in layers:
        most_deep = layer * spacing if thing.role == "scenery" else np.inf
        hits = np.count_nonzero((deep > 0) & (deep < most_deep))
        part = max(0.0, hits - _SURE * np.sqrt(hits)) / _THROWN
        found.append(part * volume / spacing**3 / layer)
    return max(found)


def _box(scene: Scene, thing: Object) -> tuple[Placement, np.ndarray, np.ndarray] | None:
    """Placement and corners (3,) [m] of a shape; None for what has none or is refused anyway."""
    if thing.shape is None:
        return None
    try:
        at = place(thing, lambda d: shapes.reach(thing.shape, d))
        low, high = corners(at, lambda d: shapes.reach(thing.shape, d))
        if thing.role == "body":
            check_inside(scene, thing, low, high, 1e-6 * spacing_of(scene, thing))
    except PlacementError:
        return None
    more = at.scale * shapes.bulge(thing.shape)
    return at, low - more, high + more
