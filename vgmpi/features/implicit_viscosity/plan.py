"""Plan of an implicit viscosity: the liquids that it slows, and scenes that it suits."""

import math
from typing import Any, NamedTuple

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan, time_step_bounds
from vgmpi.planning.step_costs import StageCost, StepCosts
from vgmpi.scene.scene import Scene

COST = StageCost(grid=0.8)  # per particle, relative to the step of a fluid's
MIN_GAIN = 3.0  # ratio of steps for the advice


class ViscousLiquid(NamedTuple):
    """Liquid with a velocity field of its own."""

    phase: int
    density: float  # [kg/m3]
    viscosity: float  # [m2/s] kinematic


class ImplicitViscosityPlan(FeaturePlan):
    """Implicit viscosity of a run.

    Attributes:
        liquids: Liquids with viscosity, each with a velocity field of its own.
    """

    name, title = "implicit_viscosity", "implicit viscosity"

    def __init__(self, liquids: tuple[ViscousLiquid, ...]):
        """Take the liquids with viscosity."""
        self.liquids = liquids

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return what it costs per particle of a viscous liquid.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        return COST if group.separate_viscosity else None

    def start(self, context: Any) -> Any:
        """Return the implicit viscosity as it acts in a run, or None without a viscous liquid.

        Args:
            context: See `FeaturePlan.start`.
        """
        if not self.liquids:
            return None
        from .coupling import ImplicitViscosity  # it compiles

        return ImplicitViscosity(context, self.liquids)


def plan_implicit_viscosity(draft: PlanDraft) -> tuple[ImplicitViscosityPlan, PlanDraft]:
    """Plan the implicit viscosity of a scene.

    Args:
        draft: Phases and groups; those of a phase have one density and viscosity.

    Returns:
        Its plan, and the draft with groups whose laws have no viscosity.
    """
    scene = draft.scene
    viscosity = {name: material.kinematic_viscosity for name, material in scene.material.items()}
    liquids = {
        group.phase: ViscousLiquid(group.phase, group.density, viscosity[group.material])
        for group in draft.groups
        if viscosity[group.material] > 0
    }
    groups = tuple(
        group._replace(
            law=group.law._replace(mu=0 * group.law.mu),  # type: ignore[attr-defined]
            separate_viscosity=True,
        )
        if group.phase in liquids
        else group
        for group in draft.groups
    )
    plan = ImplicitViscosityPlan(tuple(liquids[p] for p in sorted(liquids)))
    return plan, draft._replace(groups=groups)


def recommend_implicit_viscosity(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on a scene whose steps viscosity shortens and that has not chosen.

    Args:
        scene: A scene that can have it.
        plan: Its plan.
    """
    steps = time_step_bounds(scene, plan)
    viscous = min((step for step, cause in steps if "viscosity" in cause), default=math.inf)
    longest = min((step for step, cause in steps if "viscosity" not in cause), default=math.inf)
    if plan.time_step.fixed or longest < MIN_GAIN * viscous:
        return []
    return [
        f'  viscosity   accuracy.viscosity = "implicit" suits this scene: {longest / viscous:.0f}'
        " times fewer steps"
    ]
