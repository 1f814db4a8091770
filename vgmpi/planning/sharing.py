"""Which phases share space, and by which numbers: the scene's couplings as kernels read them."""

import numpy as np

from ..couplings.base import DRAG, MIXING, Rules
from ..materials.base import function
from ..scene.scene import Scene

SPARE = 1.25  # squared speed of waves, over the fastest fluid's own, that the step's margin bears
SHARES = 1001  # of one of two fluids, at which their waves are looked at
ROUNDS = 60  # of the speed of waves that goes with its step: half the error of each is left


def rules(scene: Scene, groups, phases) -> Rules | None:
    """The rules of a scene, None where no phases share space. groups: GroupPlan of each, phases:
    PhasePlan of each (groups.py).

    Raises SceneError where fluids that mix have one velocity field, or a group has more than one
    diffusion or slip time.
    """
    couplings = [(k, c) for k, c in enumerate(scene.coupling) if c.rule in (MIXING, DRAG)]
    if not couplings:
        return None
    n = len(phases)
    pair, drag = np.zeros((n, n), np.int64), np.zeros((n, n))
    printed = np.zeros((n, n), bool)
    of: dict[str, list[int]] = {}
    for group in groups:
        of.setdefault(group.material, []).append(group.phase)
    pairs = []
    _one_sand_per_phase(scene, couplings, groups, of)
    for k, coupling in couplings:
        for a in of.get(coupling.between[0], []):
            for b in of.get(coupling.between[1], []):
                if a == b:
                    said = "both share one velocity field: give them no phase, or different ones"
                    raise scene.error([(("coupling", k, "between"), said)])
                pair[a, b] = pair[b, a] = coupling.rule
                pairs.append((a, b))
                if coupling.rule == DRAG:
                    drag[a, b] = drag[b, a] = _coefficient(scene, coupling)
                    printed[a, b] = printed[b, a] = coupling.printed
    if not pairs:
        return None  # of materials that nothing is made of
    fluid = np.array([phase.families == ("fluid",) for phase in phases])
    mix = connected(n, [p for p in pairs if pair[p] == MIXING])
    together = connected(n, pairs)
    # fluids that meet the same sand share its pores and the pressure in them
    numbers = _mixing_numbers(scene, couplings, of, mix)
    porosity, volume = np.zeros(n), np.zeros(n)
    for group in groups:
        porosity[group.phase] = getattr(scene.material[group.material], "porosity", 0.0)
        volume[group.phase] = group.share / group.density
    return Rules(
        pair=pair,
        together=together,
        sets=int(together.max()) + 1,
        fluid=fluid,
        mix=mix,
        mixes=int(mix.max()) + 1,
        diffusion=np.array([d for d, _, _ in numbers]),
        slip_time=np.array([t for _, t, _ in numbers]),
        drag=drag,
        porosity=porosity,
        drags=bool(drag.any()),
        volume=volume,
        printed_mix=np.array([p for _, _, p in numbers], bool),
        printed_drag=printed,
    )


def _coefficient(scene: Scene, coupling) -> float:
    one, other = (scene.material[name] for name in coupling.between)
    sand, fluid = (one, other) if one.family == "sand" else (other, one)
    return coupling.coefficient(sand.porosity, fluid.density)


def _one_sand_per_phase(scene: Scene, couplings, groups, of) -> None:
    """Refuse sands of different make that share a velocity field a fluid flows through: a node
    knows their grains by mass alone."""
    makes: dict[int, set] = {}
    for group in groups:
        makes.setdefault(group.phase, set()).add((group.share, group.density))
    for k, coupling in couplings:
        for name in coupling.between:
            if coupling.rule == DRAG and scene.material[name].family == "sand":
                if any(len(makes[phase]) > 1 for phase in of.get(name, [])):
                    said = "its velocity field holds sand of another density or porosity as well:"
                    said += " give the objects of each a phase of its own"
                    raise scene.error([(("coupling", k, "between"), f"{name!r}: {said}")])


def connected(n: int, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Number of the connected set of each of n phases, -1 for those in no pair: (n,)."""
    lowest = np.arange(n)
    moved = True
    while moved:  # mostly twice, also with thousands of bodies
        moved = False
        for a, b in pairs:
            moved |= bool(lowest[a] != lowest[b])
            lowest[a] = lowest[b] = min(lowest[a], lowest[b])
    named = np.isin(np.arange(n), pairs)
    found = np.full(n, -1)
    if named.any():
        found[named] = np.unique(lowest[named], return_inverse=True)[1]
    return found


def _mixing_numbers(scene: Scene, couplings, of, mix) -> list[tuple[float, float, bool]]:
    """(diffusion, slip time, as printed) of each mixing group."""
    found: dict[int, tuple[float, float, bool]] = {}
    for k, coupling in couplings:
        if coupling.rule != MIXING:
            continue
        numbers = coupling.diffusion, coupling.slip_time, coupling.printed
        for phase in of.get(coupling.between[0], []):
            if found.setdefault(int(mix[phase]), numbers) != numbers:
                said = "fluids that mix with one another must have the same numbers and kind"
                raise scene.error([(("coupling", k), said)])
    return [found[group] for group in sorted(found) if group >= 0]


def slipping(groups: tuple, rules: Rules | None, way: float) -> tuple:
    """The groups with the squared speed of waves in a space that each shares with fluids through
    which it slips, relative to its own at rest: 1 where none is much faster than those of the
    fluids alone, and of all but the stiffer of two (docs/theory.md). way: what a wave may go in a
    step [m].
    """
    found = [1.0] * len(groups)
    if rules is None:
        return groups
    slip_time = np.append(np.where(rules.printed_mix, 0.0, rules.slip_time), 0.0)  # -1 is the last
    of = [int(rules.mix[g.phase]) for g in groups]
    free = [k for k, mix in enumerate(of) if slip_time[mix] > 0.0]
    own = {k: _wave2(groups[k]) for k in free}
    ends = {k: (groups[k].density, own[k]) for k in free}
    for k in free:
        for m in free:
            if of[m] == of[k] and np.prod(ends[k]) > np.prod(ends[m]):
                fastest = _slipping_waves(ends[k], ends[m], slip_time[of[k]], way)
                if fastest > SPARE * max(own[k], own[m]):
                    found[k] = max(found[k], fastest / own[k])
    return tuple(g._replace(slips=s) for g, s in zip(groups, found, strict=True))


def _wave2(group) -> float:
    """Squared wave speed [m2/s2] of a group at rest."""
    return float(function(group.law, "wave_speed2")(group.law, group.rest))


def _slipping_waves(one, other, slip_time: float, way: float) -> float:
    """Largest squared speed of waves [m2/s2], at any shares, in a space that two fluids share. one,
    other: density [kg/m3] and squared speed of each alone."""
    a = np.linspace(0.0, 1.0, SHARES)
    (d0, c0), (d1, c1) = one, other
    modulus = a * d0 * c0 + (1.0 - a) * d1 * c1
    mean = a * d0 + (1.0 - a) * d1
    together = modulus / mean
    apart = modulus * (a / d0 + (1.0 - a) / d1)
    found = apart
    for _ in range(ROUNDS):  # downwards, to what slips in a step of way / speed
        step = way / np.sqrt(found)
        found = together + (apart - together) / (1.0 + step / (2.0 * slip_time))
    return float(found.max())
