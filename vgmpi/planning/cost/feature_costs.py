"""Cost of each feature of a scene per particle and step: time on this processor, and memory."""

from typing import NamedTuple

from vgmpi.materials.couplings.interaction import CONTACT, DRAG, MIXING
from vgmpi.planning.correction_intervals import CORRECTION_COST, shift_cost
from vgmpi.planning.phases_and_groups import (
    CELL_DILATATION_COST,
    COLOR_COST,
    DENSITY_CORRECTION_COST,
    FLIP_COST,
    IMPLICIT_PRESSURE_COST,
)
from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

from .throughput import Throughput


class ProximityCost(NamedTuple):
    """Cost of particles at most one block away from something that they may touch.

    The unit is one step of a fluid particle. Fitted by `python -m tests.benchmarks step-model`
    to steps of scenes as they run.
    """

    particle: float  # per particle
    block: float  # per block of particles
    nodes: float  # per node block that both phases reach


SURFACE_CONTACT_COST = ProximityCost(0.5, 80.0, 50.0)  # contact of solids with surface descriptors
CONTACT_COST = ProximityCost(0.5, 150.0, 100.0)  # contact of other bodies
MIXING_COST = ProximityCost(1.3, 210.0, 65.0)
DRAG_COST = ProximityCost(0.35, 50.0, 50.0)
# The collider costs are in steps of a fluid particle, per particle at most a block from one.
COLLIDER_COST = 1.3  # colliders at rest
MOVING_COLLIDER_COST = 0.6  # additional cost if a collider moves
RIGID_BODY_COST = 0.5  # free rigid bodies (python -m tests.benchmarks bodies)
REACTION_PROBE_COST = 1.2  # additional cost if a probe measures reaction forces
# Cost of a block without its particles, and of the disorder that comes with partly filled blocks.
BLOCK_COST = 190.0
PARTICLES_PER_BLOCK = 300  # mean of the cube with which a throughput is measured


class Feature(NamedTuple):
    """Name and cost of one feature of a group."""

    name: str
    ns: float  # [ns] per particle and step on one core, mean over the group as it stands
    bytes: int = 0  # [bytes] per particle
    dimension: int = 3  # 3: costs grow as the volume of bodies in cells, 2: as their surface


def group_features(scene: Scene, plan: Plan, g: int, pace: Throughput) -> list[Feature]:
    """Return the features of group `g`, its law first.

    Args:
        scene: The scene.
        plan: Its plan.
        g: Number of the group.
        pace: Throughput of the processor.
    """
    group = plan.groups[g]
    law_ns = pace.law(scene.material[group.material])
    fields = plan.fields(g)
    if group.pinned:
        return [Feature("carried by what holds it", pace.fluid * group.cost, sum(fields.values()))]
    own = {name: fields.pop(name, 0) for name in ("share", "F", "surface", "color")}
    result = [Feature(f"law {scene.material[group.material].kind}", law_ns, sum(fields.values()))]
    if own["F"]:
        result.append(Feature("deformation that Gaussians follow", 0.0, own["F"]))
    transfer = f"{scene.accuracy.transfer} transfer"
    if plan.restores:
        result.append(Feature(transfer, law_ns * CORRECTION_COST / plan.restores))
    if plan.keeps is not None:
        result.append(Feature(transfer, law_ns * (FLIP_COST - 1.0)))
    if group.shifts:
        by_volume = plan.phases[group.phase].fills_by_volume
        shifting = law_ns * shift_cost(plan.restores > 0, plan.shift_interval, by_volume)
        result.append(Feature("particle shifting", shifting))
    if group.cell_dilatation:
        result.append(Feature("dilatation by cells", law_ns * CELL_DILATATION_COST))
    if group.implicit_pressure:
        result.append(Feature("implicit pressure", law_ns * IMPLICIT_PRESSURE_COST))
    if group.space:
        result.append(Feature("density correction", law_ns * DENSITY_CORRECTION_COST))
    if group.coefficients:
        ns = pace.fluid * COLOR_COST * group.coefficients
        result.append(Feature("colors that travel", ns, own["color"]))
    result += _meetings(plan, g, pace.fluid, own)
    result += _colliders(scene, plan, g, pace.fluid)
    return result + _blocks(plan, g, pace.fluid)


def _meetings(plan: Plan, g: int, fluid: float, own: dict[str, int]) -> list[Feature]:
    """Return the cost of the proximity of other phases, as the particles stand."""
    p, result = plan.groups[g].phase, []
    met: dict[str, list[tuple[ProximityCost, str]]] = {}
    for q, phase in enumerate(plan.phases):
        if q != p:
            name, how = _rule(plan, p, q)
            met.setdefault(name, []).append((how, phase.name))
    sizes = {"drag": own["share"], "contact": own["surface"]}
    for name in ("mixing", "drag", "contact"):
        share, ns = _proximity_cost(plan, g, met.get(name, []))
        if share or sizes.get(name):
            result.append(Feature(_with_percentage(name, share), fluid * ns, sizes.get(name, 0), 2))
    return result


def _rule(plan: Plan, p: int, q: int) -> tuple[str, ProximityCost]:
    """Return name and cost of the interaction of two phases."""
    rule = CONTACT if plan.rules is None else plan.rules.pair[p, q]
    if rule == MIXING:
        return "mixing", MIXING_COST
    if rule == DRAG:
        return "drag", DRAG_COST
    surfaces = plan.phases[p].surface and plan.phases[q].surface
    return "contact", SURFACE_CONTACT_COST if surfaces else CONTACT_COST


def _proximity_cost(
    plan: Plan, g: int, met: list[tuple[ProximityCost, str]]
) -> tuple[float, float]:
    """Return the fraction of the group's particles near other phases, and the mean cost.

    The cost is in steps of a fluid particle, averaged over all particles of the group.
    """
    n = near_count = cost = 0.0
    for k in _rows(plan, g):
        count, proximity = plan.count[k], plan.surroundings[k]
        by_phase = {q.phase: q for q in proximity.phases}
        pairs = [(rate, by_phase[phase]) for rate, phase in met if phase in by_phase]
        n += count
        near_count += count * min(sum(q.share for _, q in pairs), 1.0)
        cost += sum(
            rate.particle * count * q.share + rate.block * q.blocks + rate.nodes * q.nodes
            for rate, q in pairs
        )
    return (near_count / n, cost / n) if n else (0.0, 0.0)


def _colliders(scene: Scene, plan: Plan, g: int, fluid: float) -> list[Feature]:
    """Return the cost of the proximity of colliders, as the particles stand."""
    share = _mean([(plan.count[k], plan.surroundings[k].collider) for k in _rows(plan, g)])
    if not share:
        return []
    costs = {}
    if any(entity.collider and entity.free_body is None for entity in scene.object):
        costs[_with_percentage("colliders", share)] = COLLIDER_COST
    if any(entity.collider and entity.motion for entity in scene.object):
        costs["colliders that move"] = MOVING_COLLIDER_COST
    if plan.free_bodies:
        costs[_with_percentage("free rigid bodies", share)] = RIGID_BODY_COST
    if plan.feels:
        costs["probes of what colliders give"] = REACTION_PROBE_COST
    return [Feature(name, fluid * cost * share, 0, 2) for name, cost in costs.items()]


def _blocks(plan: Plan, g: int, fluid: float) -> list[Feature]:
    """Return the extra cost of blocks with fewer particles than a throughput is measured with."""
    rows = _rows(plan, g)
    blocks = sum(plan.surroundings[k].blocks for k in rows)
    n = sum(plan.count[k] for k in rows)
    more = BLOCK_COST * (blocks / max(n, 1) - 1.0 / PARTICLES_PER_BLOCK)
    if more < 0.02:  # negligible
        return []
    return [Feature(f"blocks of {n / blocks:.0f} particles", fluid * more, 0, 2)]


def feature_table(scene: Scene, plan: Plan, pace: Throughput) -> list[str]:
    """Return the lines of --plan on the features of all groups, at the start."""
    lines = [
        f"  price       {'of a particle and a step, at the start':46s} {'ns':>8s} {'bytes':>7s}"
    ]
    for g, group in enumerate(plan.groups):
        if not any(group_number == g for _, group_number in group_counts(plan)):
            continue
        for feature in group_features(scene, plan, g, pace):
            ns = f"{feature.ns:.1f}" if feature.ns else ""
            name = escape_control_characters(f"{group.name}: {feature.name}")
            lines.append(f"              {name:46s} {ns:>8s} {feature.bytes or '':>7}".rstrip())
    return lines


def step_ns(scene: Scene, plan: Plan, pace: Throughput, coarsening: float = 1.0) -> float:
    """Return the time of a step of all particles on one core [ns].

    Args:
        scene: The scene.
        plan: Its plan.
        pace: Throughput of the processor.
        coarsening: Cells along an edge over those of the scene.
    """
    total = 0.0
    for g in range(len(plan.groups)):
        n = sum(count for count, group_number in group_counts(plan) if group_number == g)
        if n:
            features = group_features(scene, plan, g, pace)
            total += n * sum(feature.ns * coarsening**feature.dimension for feature in features)
    return total


def _rows(plan: Plan, g: int) -> list[int]:
    """Return the objects whose proximity is known, of which particles belong to group `g`."""
    parts = {region.thing for region in plan.regions if region.group == g}
    return [k for k, _ in enumerate(plan.surroundings) if plan.group_of[k] == g or k in parts]


def _mean(pairs: list[tuple[int, float]]) -> float:
    """Return the mean of (count, fraction) pairs, weighted by the counts; 0 without particles."""
    total = sum(n for n, _ in pairs)
    return sum(n * fraction for n, fraction in pairs) / total if total else 0.0


def _with_percentage(name: str, share: float) -> str:
    """Format a feature's name with the percentage of particles near enough."""
    return f"{name}, {100 * share:.0f} % near" if share else f"{name}, none near"
