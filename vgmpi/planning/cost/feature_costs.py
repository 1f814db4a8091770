"""Cost of each feature of a scene per particle and step, and of a step besides its particles."""

from dataclasses import astuple
from typing import NamedTuple

from vgmpi.planning.plan import Plan
from vgmpi.planning.region_groups import group_counts
from vgmpi.planning.step_costs import COSTS, STAGES, ProximityCost, StageCost, StepCosts
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

from .throughput import Throughput

PARTICLES_PER_BLOCK = 300  # mean of the cube with which a throughput is measured
MIN_BLOCK_COST = 0.02  # [-] of a fluid's step, below which emptier blocks have no line

# [s] of processor time, from pilot runs (`python -m tests.benchmarks predictions`)
STEP_SECONDS = 1e-4  # a step of one phase (`python -m tests.benchmarks overhead`)
PHASE_SECONDS = 1.5e-4  # each further phase
COLLIDER_SECONDS = 1.5e-4  # a collider at rest
MOVING_COLLIDER_SECONDS = 1.5e-3  # one that moves


class Feature(NamedTuple):
    """Name and cost of one feature of a group."""

    name: str
    time: StageCost  # [ns] per particle and step on one core, mean over the group as it stands
    bytes: int = 0  # [bytes] per particle
    dimension: int = 3  # 3: costs grow as the volume of bodies in cells, 2: as their surface

    @property
    def ns(self) -> float:
        """Return the time of all stages [ns] per particle and step."""
        return self.time.total


def group_features(
    scene: Scene, plan: Plan, g: int, pace: Throughput, costs: StepCosts = COSTS
) -> list[Feature]:
    """Return the features of group `g`, its law first.

    Args:
        scene: The scene.
        plan: Its plan.
        g: Number of the group.
        pace: Throughput of the processor.
        costs: Costs of the parts of a step.
    """
    group = plan.groups[g]
    fields = plan.fields(g)
    if group.carrier:
        time = pace.fluid * group.cost * costs.law
        return [Feature("carried by what holds it", time, sum(fields.values()))]
    extra = [name for feature in plan.features for name in feature.particle_channels]
    own = {name: fields.pop(name, 0) for name in ("share", "F", "surface", *extra)}
    law_time = pace.law(scene.material[group.material]) * costs.law
    law_name = f"law {scene.material[group.material].kind}"
    result = [Feature(law_name, law_time, sum(fields.values()))]
    if own["F"]:
        result.append(Feature("deformation that Gaussians follow", StageCost(), own["F"]))
    transfer = f"{scene.accuracy.transfer} transfer"
    if plan.correction_interval:
        result.append(Feature(transfer, pace.fluid / plan.correction_interval * costs.correction))
    if group.volume.by_cells:
        result.append(Feature("dilatation by cells", pace.fluid * costs.cell_dilatation))
    for feature in plan.features:
        if (cost := feature.particle_cost(group, costs)) is not None:
            size = sum(own[name] for name in feature.particle_channels)
            result.append(Feature(feature.title, pace.fluid * cost, size))
    if group.volume.inverse_cell_mass:
        result.append(Feature("density correction", pace.fluid * costs.density_correction))
    result += _meetings(plan, g, pace.fluid, own, costs)
    result += _colliders(scene, plan, g, pace.fluid, costs)
    return result + _blocks(plan, g, pace.fluid, costs)


def _meetings(
    plan: Plan, g: int, fluid: float, own: dict[str, int], costs: StepCosts
) -> list[Feature]:
    """Return the cost of the proximity of other phases, as the particles stand."""
    p, result = plan.groups[g].phase, []
    met: dict[str, list[tuple[ProximityCost, str]]] = {}
    for q, phase in enumerate(plan.phases):
        if q != p:
            name, how = _interaction(plan, p, q, costs)
            met.setdefault(name, []).append((how, phase.name))
    channels = {k: v for feature in plan.features for k, v in feature.pair_channels.items()}
    channels["contact"] = "surface"
    sizes = {name: own.get(channel, 0) for name, channel in channels.items()}
    for name in channels:
        share, cost = _proximity_cost(plan, g, met.get(name, []))
        if share or sizes.get(name):
            title = _with_percentage(name, share)
            result.append(Feature(title, fluid * cost, sizes.get(name, 0), 2))
    return result


def _interaction(plan: Plan, p: int, q: int, costs: StepCosts) -> tuple[str, ProximityCost]:
    """Return name and cost of the interaction of two phases."""
    for feature in plan.features:
        if (cost := feature.pair_cost(p, q, costs)) is not None:
            return cost
    surfaces = plan.phases[p].surface and plan.phases[q].surface
    return "contact", costs.surface_contact if surfaces else costs.contact


def _proximity_cost(
    plan: Plan, g: int, met: list[tuple[ProximityCost, str]]
) -> tuple[float, StageCost]:
    """Return the fraction of the group's particles near other phases, and the mean cost.

    The cost is in steps of a fluid particle, averaged over all particles of the group.
    """
    n = near_count = 0.0
    cost = StageCost()
    for k in _rows(plan, g):
        count, proximity = plan.count[k], plan.measures.proximity[k]
        by_phase = {q.phase: q for q in proximity.phases}
        pairs = [(rate, by_phase[phase]) for rate, phase in met if phase in by_phase]
        n += count
        near_count += count * min(sum(q.share for _, q in pairs), 1.0)
        for rate, q in pairs:
            cost += count * q.share * rate.particle + q.blocks * rate.block + q.nodes * rate.nodes
    return (near_count / n, cost * (1.0 / n)) if n else (0.0, cost)


def _colliders(scene: Scene, plan: Plan, g: int, fluid: float, costs: StepCosts) -> list[Feature]:
    """Return the cost of the proximity of colliders, as the particles stand."""
    rows = _rows(plan, g)
    share = _mean([(plan.count[k], plan.measures.proximity[k].collider) for k in rows])
    if not share:
        return []
    cost_by_name = {}
    moved = sum(feature.moved_colliders for feature in plan.features)
    if sum(entity.collider for entity in scene.object) > moved:
        cost_by_name[_with_percentage("colliders", share)] = costs.collider
    if any(entity.collider and entity.motion for entity in scene.object):
        cost_by_name["colliders that move"] = costs.moving_collider
    for feature in plan.features:
        if feature.moved_colliders:
            title = _with_percentage(feature.collider_title, share)
            cost_by_name[title] = costs.coupled_collider
        if feature.collider_cost is not None:
            cost_by_name[feature.title] = feature.collider_cost
    blocks = sum(plan.measures.proximity[k].blocks for k in rows) / sum(plan.count[k] for k in rows)
    return [
        Feature(name, fluid * share * (cost.particle + blocks * cost.block), 0, 2)
        for name, cost in cost_by_name.items()
    ]


def _blocks(plan: Plan, g: int, fluid: float, costs: StepCosts) -> list[Feature]:
    """Return the extra cost of blocks with fewer particles than a throughput is measured with."""
    rows = _rows(plan, g)
    blocks = sum(plan.measures.proximity[k].blocks for k in rows)
    n = sum(plan.count[k] for k in rows)
    excess = blocks / max(n, 1) - 1.0 / PARTICLES_PER_BLOCK
    if excess * costs.block.total < MIN_BLOCK_COST:
        return []
    return [Feature(f"blocks of {n / blocks:.0f} particles", fluid * excess * costs.block, 0, 2)]


def feature_table(scene: Scene, plan: Plan, pace: Throughput) -> list[str]:
    """Return the lines of --plan on the features of all groups, at the start."""
    if not any(plan.count):
        return []
    stages = "".join(f"{stage:>6s}" for stage in STAGES)
    lines = [
        f"  price       {'of a particle and a step, at the start':46s}{'ns':>6s}{stages} bytes"
    ]
    for g, group in enumerate(plan.groups):
        if any(group_number == g for _, group_number in group_counts(plan)):
            for feature in group_features(scene, plan, g, pace):
                name = f"{group.name}: {feature.name}"
                lines.append(_table_row(name, feature.time, str(feature.bytes or "")))
    mean = step_time(scene, plan, pace) * (1.0 / max(1, plan.particles))
    return [*lines, _table_row("mean of all particles", mean, "")]


def _table_row(name: str, time: StageCost, size: str) -> str:
    """Format a row of the table: name, time in all and by stage [ns], and bytes."""
    numbers = [f"{ns:6.1f}" if ns >= 0.05 else 6 * " " for ns in (time.total, *astuple(time))]
    return (
        f"              {escape_control_characters(name):46s}{''.join(numbers)} {size:>5s}".rstrip()
    )


def step_time(
    scene: Scene, plan: Plan, pace: Throughput, costs: StepCosts = COSTS, coarsening: float = 1.0
) -> StageCost:
    """Return the time of a step of all particles on one core by stage [ns].

    Args:
        scene: The scene.
        plan: Its plan.
        pace: Throughput of the processor.
        costs: Costs of the parts of a step.
        coarsening: Cells along an edge over those of the scene.
    """
    result = StageCost()
    for g in range(len(plan.groups)):
        n = sum(count for count, group_number in group_counts(plan) if group_number == g)
        if n:
            for feature in group_features(scene, plan, g, pace, costs):
                result += n * coarsening**feature.dimension * feature.time
    return result


def step_ns(scene: Scene, plan: Plan, pace: Throughput, coarsening: float = 1.0) -> float:
    """Return the time of a step of all particles on one core [ns].

    Args:
        scene, plan, pace, coarsening: See `step_time`.
    """
    return step_time(scene, plan, pace, COSTS, coarsening).total


def step_overhead(scene: Scene, plan: Plan) -> float:
    """Return the processor time [s] of a step besides its particles.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    colliders = [obj for obj in scene.object if obj.collider]
    moving = sum(obj.motion is not None for obj in colliders)
    moving += sum(feature.moved_colliders for feature in plan.features)
    return (
        STEP_SECONDS
        + PHASE_SECONDS * max(len(plan.phases) - 1, 0)
        + COLLIDER_SECONDS * (len(colliders) - moving)
        + MOVING_COLLIDER_SECONDS * moving
        + sum(feature.step_seconds for feature in plan.features)
    )


def _rows(plan: Plan, g: int) -> list[int]:
    """Return the objects whose proximity is known, of which particles belong to group `g`."""
    parts = {region.object for region in plan.regions if region.group == g}
    return [k for k, _ in enumerate(plan.measures.proximity) if plan.group_of[k] == g or k in parts]


def _mean(pairs: list[tuple[int, float]]) -> float:
    """Return the mean of (count, fraction) pairs, weighted by the counts; 0 without particles."""
    total = sum(n for n, _ in pairs)
    return sum(n * fraction for n, fraction in pairs) / total if total else 0.0


def _with_percentage(name: str, share: float) -> str:
    """Format a feature's name with the percentage of particles near enough."""
    return f"{name}, {100 * share:.0f} % near" if share else f"{name}, none near"
