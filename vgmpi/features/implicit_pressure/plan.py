"""Plan of an implicit pressure: its groups, fields and costs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vgmpi.kernels.reproducible_sums import next_power_of_two
from vgmpi.materials.couplings.interaction import CONTACT, PRESSURE
from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan, VolumeTerms, WaveTerms
from vgmpi.planning.plan import Plan
from vgmpi.planning.step_costs import ProximityCost, StageCost, StepCosts

COST = StageCost(0.1, 2.2, 0.2)  # per particle, relative to the step of a fluid's
STEP_SECONDS = 0.006  # [s] of a step besides, for coarse grids and calls (driftwood, two_liquids)
PARTICLE_PRESSURE, LIQUID_VOLUME = "particle pressure", "liquid volume"  # nodal fields
DISPLACEMENT = "displacement"  # nodal displacement [cells] and relative pressure, for particles


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
    """
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
