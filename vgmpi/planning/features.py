"""What each feature of a scene costs a particle in a step: time on this processor, and memory."""

from typing import NamedTuple

from ..couplings.base import CONTACT, DRAG, MIXING
from ..scene.scene import Scene
from ..source import printable
from .groups import COLOUR_COST, HOLDING_COST, KEEPING_COST, RESTORING_COST
from .pace import Pace
from .plan import Plan


class Meeting(NamedTuple):
    """What it costs to stand at most a block from what may be touched, in steps of a fluid's
    particle (`python -m vgmpi.bench.studies features`, `couplings`; runs/two_liquids,
    water_on_snow)."""

    particle: float
    block: float  # of particles
    nodes: float  # a block of them that both reach


SOLIDS = Meeting(1.6, 100.0, 85.0)  # contact of solids whose surfaces are known
TOUCHING = Meeting(0.8, 100.0, 85.0)  # contact of others
MIXES = Meeting(1.3, 200.0, 65.0)
DRAGS = Meeting(0.4, 60.0, 65.0)
# of a fluid's step, for each particle that stands at most a block from a collider
COLLIDER_COST = 1.3  # colliders at rest
MOVING_COST = 0.6  # more where some move
FELT_COST = 1.2  # more where a probe asks what they give
BLOCK_COST = 35.0  # of a block beside its particles (docs/performance.md)
FULL = 512  # particles of the blocks by which a Pace is measured


class Feature(NamedTuple):
    """Something that a group's particles cost."""

    name: str
    ns: float  # of a particle and step on one core, in the mean over the group as it stands
    bytes: int = 0  # of a particle


def features(scene: Scene, plan: Plan, g: int, pace: Pace) -> list[Feature]:
    """Those of group g that the scene has, its law first."""
    group = plan.groups[g]
    law = pace.law(scene.material[group.material])
    fields = plan.fields(g)
    own = {name: fields.pop(name, 0) for name in ("share", "F", "surface", "colour")}
    found = [Feature(f"law {scene.material[group.material].kind}", law, sum(fields.values()))]
    if own["F"]:
        found.append(Feature("deformation that Gaussians follow", 0.0, own["F"]))
    if plan.restores:
        found.append(Feature("restored transfer", law * RESTORING_COST / plan.restores))
    if plan.keeps is not None:
        found.append(Feature(f"{scene.accuracy.transfer} transfer", law * (KEEPING_COST - 1.0)))
    if group.space:
        found.append(Feature("volume that is kept", law * HOLDING_COST))
    if group.coefficients:
        ns = pace.fluid * COLOUR_COST * group.coefficients
        found.append(Feature("colours that travel", ns, own["colour"]))
    found += _meetings(plan, g, pace.fluid, own)
    found += _colliders(scene, plan, g, pace.fluid)
    return found + _blocks(plan, g, pace.fluid)


def _meetings(plan: Plan, g: int, fluid: float, own: dict[str, int]) -> list[Feature]:
    """What other phases cost the group's particles as they stand."""
    p, found = plan.groups[g].phase, []
    met: dict[str, list[tuple[Meeting, str]]] = {}
    for q, phase in enumerate(plan.phases):
        if q != p:
            name, how = _rule(plan, p, q)
            met.setdefault(name, []).append((how, phase.name))
    kept = {"drag": own["share"], "contact": own["surface"]}
    for name in ("mixing", "drag", "contact"):
        near, ns = _met(plan, g, met.get(name, []))
        if near or kept.get(name):
            found.append(Feature(_near(name, near), fluid * ns, kept.get(name, 0)))
    return found


def _rule(plan: Plan, p: int, q: int) -> tuple[str, Meeting]:
    rule = CONTACT if plan.rules is None else plan.rules.pair[p, q]
    if rule == MIXING:
        return "mixing", MIXES
    if rule == DRAG:
        return "drag", DRAGS
    surfaces = plan.phases[p].surface and plan.phases[q].surface
    return "contact", SOLIDS if surfaces else TOUCHING


def _met(plan: Plan, g: int, met: list[tuple[Meeting, str]]) -> tuple[float, float]:
    """Share of the group's particles that are near, and what that costs in the mean over all of
    them, in steps of a fluid's particle."""
    n = near = cost = 0.0
    for k in _rows(plan, g):
        count, around = plan.count[k], plan.surroundings[k]
        there = {one.phase: one for one in around.phases}
        here = [(how, there[phase]) for how, phase in met if phase in there]
        n += count
        near += count * min(sum(one.share for _, one in here), 1.0)
        # what is near several of them is not so several times
        wide = max(sum(one.blocks for _, one in here) / max(around.blocks, 1), 1.0)
        cost += sum(
            (how.particle * count * one.share + how.block * one.blocks + how.nodes * one.nodes)
            / wide for how, one in here
        )  # fmt: skip
    return (near / n, cost / n) if n else (0.0, 0.0)


def _colliders(scene: Scene, plan: Plan, g: int, fluid: float) -> list[Feature]:
    """What colliders cost the group's particles as they stand."""
    share = _mean([(plan.count[k], plan.surroundings[k].collider) for k in _rows(plan, g)])
    if not share:
        return []
    found = [Feature(_near("colliders", share), fluid * COLLIDER_COST * share)]
    if any(thing.collider and thing.motion for thing in scene.object):
        found.append(Feature("colliders that move", fluid * MOVING_COST * share))
    if plan.feels:
        found.append(Feature("probes of what colliders give", fluid * FELT_COST * share))
    return found


def _blocks(plan: Plan, g: int, fluid: float) -> list[Feature]:
    """What blocks cost that hold less than those by which a Pace is measured."""
    rows = _rows(plan, g)
    blocks = sum(plan.surroundings[k].blocks for k in rows)
    n = sum(plan.count[k] for k in rows)
    more = BLOCK_COST * (blocks / max(n, 1) - 1.0 / FULL)
    if more < 0.02:  # nothing to speak of
        return []
    return [Feature(f"blocks of {n / blocks:.0f} particles", fluid * more)]


def table(scene: Scene, plan: Plan, pace: Pace) -> list[str]:
    """Lines of all groups: what is there at the start."""
    lines = [
        f"  price       {'of a particle and a step, at the start':46s} {'ns':>8s} {'bytes':>7s}"
    ]
    for g, group in enumerate(plan.groups):
        if not any(plan.group_of[k] == g for k in range(len(plan.count))):
            continue
        for one in features(scene, plan, g, pace):
            ns = f"{one.ns:.1f}" if one.ns else ""
            name = printable(f"{group.name}: {one.name}")
            lines.append(f"              {name:46s} {ns:>8s} {one.bytes or '':>7}".rstrip())
    return lines


def step(scene: Scene, plan: Plan, pace: Pace) -> float:
    """Time of a step of all particles on one core [ns]."""
    total = 0.0
    for g in range(len(plan.groups)):
        n = sum(plan.count[k] for k, of in enumerate(plan.group_of) if of == g)
        if n:
            total += n * sum(one.ns for one in features(scene, plan, g, pace))
    return total


def _rows(plan: Plan, g: int) -> list[int]:
    """The objects of group g of which it is known how they stand."""
    return [k for k, _ in enumerate(plan.surroundings) if plan.group_of[k] == g]


def _mean(of: list[tuple[int, float]]) -> float:
    total = sum(n for n, _ in of)
    return sum(n * share for n, share in of) / total if total else 0.0


def _near(name: str, share: float) -> str:
    """With how many of the particles are near enough."""
    return f"{name}, {100 * share:.0f} % near" if share else f"{name}, none near"
