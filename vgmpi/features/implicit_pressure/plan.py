"""Plan of an implicit pressure: scenes that can have it, its groups, fields and costs."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.materials.couplings.interaction import CONTACT, DRAG, MIXING, PRESSURE
from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan, PhasePlan, VolumeTerms, WaveTerms
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.planning.step_costs import ProximityCost, StageCost, StepCosts
from vgmpi.scene.scene import Scene
from vgmpi.scene.scene_feature import features

MAX_CONTRAST = 10_000.0  # [-] of densities; beyond it runs were seen to blow up
MAX_FREE_BODIES = 64  # the work of a step grows with the cube of their number
HELD_BODIES = "bodies of particles that are held or moved, and colliders with friction"
COST = StageCost(0.1, 2.2, 0.2)  # per particle, relative to the step of a fluid's
STEP_SECONDS = 0.006  # [s] of a step besides, for coarse grids and calls (driftwood, two_liquids)
PARTICLE_PRESSURE, LIQUID_VOLUME = "particle pressure", "liquid volume"  # nodal fields
DISPLACEMENT = "displacement"  # nodal displacement [cells] and relative pressure, for particles
MIN_VISCOUS_RATIO = 4.0  # of the viscous bound of the step to that by waves, for the advice


class ImplicitPressurePlan(FeaturePlan):
    """Implicit pressure of a run.

    Attributes:
        ambient_pressure: Suction that liquids bear everywhere [Pa], None for any.
    """

    name, title = "implicit_pressure", "implicit pressure"
    gathered, step_seconds = (DISPLACEMENT,), STEP_SECONDS

    def __init__(
        self, groups: Sequence[GroupPlan], phases: int, ambient_pressure: float | None = None
    ):  # fmt: skip
        """Take the groups whose pressure the grid finds, the number of phases, and the suction."""
        self.ambient_pressure = ambient_pressure
        if phases > 1:
            is_liquid = np.isin(np.arange(phases), [group.phase for group in groups])
            self.pair_rules = np.where(is_liquid[:, None] | is_liquid, PRESSURE, CONTACT)
            self.counts_volumes = not is_liquid.all()

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return what it costs per particle of a liquid.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        return COST if group.volume.separate_pressure else None

    def pair_cost(self, p: int, q: int, costs: StepCosts) -> tuple[str, ProximityCost] | None:
        """Return that two liquids in contact cost nothing more.

        Args:
            p, q, costs: See `FeaturePlan.pair_cost`.
        """
        if self.pair_rules is None or self.pair_rules[p, q] == CONTACT:
            return None
        return "pressure", ProximityCost(StageCost(), StageCost())

    def field_requests(self, plan: Plan) -> tuple:
        """Return the request for the pressure of the particles at the nodes."""
        from .pressure_transfer import request_liquid_fields  # it compiles

        return request_liquid_fields(plan)

    def gathers(self, group: GroupPlan) -> tuple[str, ...]:
        """Return what the particles of a group gather: its displacement and pressure."""
        return self.gathered if group.volume.separate_pressure else ()

    def gather_kind(self, group: GroupPlan, nodes: dict, dt: float, patch: int) -> Any:
        """Return the kind with which the particles of a group gather them.

        Args:
            group, nodes, dt, patch: See `FeaturePlan.gather_kind`.
        """
        from .pressure_transfer import ImplicitPressureGather

        exponent = group.law.gamma  # type: ignore[attr-defined]
        return ImplicitPressureGather(nodes[DISPLACEMENT], patch, exponent)

    def start(self, context: Any) -> Any:
        """Return the implicit pressure as it acts in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import ImplicitPressure  # they compile
        from .pressure_solver import PressureSolver, SystemDomain
        from .suction_limit import limit_suction

        plan = context.plan
        is_closed = [kind != "open" for kind, _ in plan.walls.liquids]
        closed = np.array(is_closed).reshape(3, 2)
        densities = [group.density for group in liquid_groups(plan)]
        contrast = float(next_power_of_two(max(densities) / min(densities)))
        solver = PressureSolver(
            context.ranks, SystemDomain(plan.cells, closed, contrast), plan.real
        )
        suction = limit_suction(self.ambient_pressure, plan, len(context.colliders))
        return ImplicitPressure(context, solver, suction)


def plan_implicit_pressure(draft: PlanDraft) -> tuple[ImplicitPressurePlan, PlanDraft]:
    """Plan the implicit pressure of a scene.

    Args:
        draft: Phases and groups.

    Returns:
        Its plan, and the draft with groups whose pressure is not that of their volume. Their laws
        have the largest Tait coefficient of the scene, which is a unit of pressure only.

    Raises:
        SceneError: The scene has what an implicit pressure does not know.
    """
    if wrong := obstacles(draft.scene, draft.groups, draft.phases):
        raise draft.scene.error(wrong)
    coefficient = draft.scene.largest_tait_coefficient
    groups = tuple(
        group._replace(
            law=group.law._replace(k=type(group.law[0])(coefficient)),  # type: ignore[attr-defined]
            volume=VolumeTerms(separate_pressure=True),
            wave=WaveTerms(factor=0.0),
        )
        if group.is_liquid
        else group
        for group in draft.groups
    )
    liquids = [group for group in groups if group.is_liquid]
    ambient_pressure = draft.scene.domain.ambient_pressure
    plan = ImplicitPressurePlan(liquids, len(draft.phases), ambient_pressure)
    return plan, draft._replace(groups=groups)


def liquid_groups(plan: Plan) -> list[GroupPlan]:
    """Return the groups of a plan whose pressure the grid finds."""
    return [group for group in plan.groups if group.volume.separate_pressure]


def recommend_implicit_pressure(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on a scene for which it is the better choice and that has not chosen.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    steps = time_step_bounds(scene, plan)
    viscous = [step for step, cause in steps if "viscosity" in cause]
    shortest = min(step for step, _ in steps)
    chosen = {"pressure", "transfer", "volume_correction", "dilatation"}
    if plan.time_step.fixed or min(viscous, default=math.inf) <= MIN_VISCOUS_RATIO * shortest:
        return []
    if len(plan.phases) > 1:
        return []  # the gain below is that of one liquid, and gaps open between liquids apart
    if chosen & scene.accuracy.model_fields_set or obstacles(scene, plan.groups, plan.phases):
        return []
    return [
        '  pressure    accuracy.pressure = "implicit" suits this scene: 3 to 11 times fewer steps,'
        " at equal or smaller error"
    ]


def obstacles(
    scene: Scene, groups: Sequence[GroupPlan], phases: Sequence[PhasePlan]
) -> list[tuple[tuple, str]]:
    """Return (path of a key, message) of all that an implicit pressure does not know.

    Args:
        scene: The scene.
        groups: All groups.
        phases: All phases.
    """
    wrong: list[tuple[tuple, str]] = []

    def _refuse(path: tuple, feature: str) -> None:
        wrong.append((path, f"accuracy.pressure = 'implicit' is not for {feature}"))

    for name in dict.fromkeys(group.material for group in groups):
        material: Any = scene.material[name]
        if material.kind != "fluid":
            if material.family == "fluid" or not any(g.wave.on_grid for g in groups):
                _refuse(("material", name, "kind"), "materials that are no fluid")
        elif material.tension == "off":
            _refuse(("material", name, "tension"), "liquids without tension")
    for k, coupling in enumerate(scene.coupling):
        if coupling.rule in (MIXING, DRAG) and coupling.printed:
            _refuse(("coupling", k, "kind"), f"couplings of kind {coupling.kind!r}")
        kinds = {scene.material[name].kind for name in coupling.between}
        if coupling.rule == CONTACT and coupling.friction and "fluid" in kinds:
            _refuse(("coupling", k, "friction"), "friction of liquids")
        if coupling.rule == DRAG and not all_flow_through(scene, groups, coupling):
            what = "sands through which only some of the liquids flow"
            _refuse(("coupling", k, "between"), what)
    densities = {group.density: group.material for group in groups if group.is_liquid}
    if not densities:
        _refuse(("accuracy", "pressure"), "scenes without a liquid")
        return wrong
    if max(densities) > MAX_CONTRAST * min(densities):
        name = densities[min(densities)]
        what = f"liquids that are more than {MAX_CONTRAST:,.0f} times as heavy as others"
        _refuse(("material", name, "density"), what)
    for k, obj in enumerate(scene.object):
        values = {
            "motion": obj.motion and not obj.collider,
            "friction": obj.friction,
            **{key: True for feature in features() for key in feature.keys_of(obj)},
        }  # fmt: skip
        values.pop("pinned", None)  # an implicit elasticity has them
        values.pop("slip_length", None)
        for key, value in values.items():
            if value:
                _refuse(("object", k, key), HELD_BODIES)
    rigid = [k for k, obj in enumerate(scene.object) if obj.rigid]
    if len(rigid) > MAX_FREE_BODIES:
        _refuse(("object", rigid[-1], "rigid"), f"more than {MAX_FREE_BODIES} free rigid bodies")
    for feature in features():
        for name in () if feature.suits_implicit_pressure else feature.lists:
            if scene.lists[name]:
                _refuse((name, 0), feature.title)
    if any(time is not None for time in scene.domain.wall_opening_times):
        _refuse(("domain", "boundary"), "walls that open")
    return wrong


def all_flow_through(scene: Scene, groups: Sequence[GroupPlan], drag: Any) -> bool:
    """Return whether all liquids of a scene flow through the sand of a drag, if any object has it.

    Args:
        scene: The scene.
        groups: All groups.
        drag: A coupling with drag.
    """
    sand = next(name for name in drag.between if scene.material[name].family == "sand")
    liquids = {group.material for group in groups if group.is_liquid}
    through = {
        name
        for coupling in scene.coupling
        if coupling.rule == DRAG and sand in coupling.between
        for name in coupling.between
    }
    return liquids <= through or all(group.material != sand for group in groups)
