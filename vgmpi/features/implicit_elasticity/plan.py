"""Plan of an implicit elasticity: the solids whose waves it slows."""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.materials.couplings.interaction import DRAG
from vgmpi.materials.material import law_function
from vgmpi.parallel.exchange_topology import StressProximity
from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.step_costs import StageCost, StepCosts

# per particle of a solid, relative to the step of a fluid's: of the stress alone, within the
# pressure of liquids, and with liquid in its pores (splash, faucet, water_on_snow, castle_flood)
SWEEP_COST, SWEEP_COST_IN_LIQUID, SWEEP_COST_OF_PORES = (
    StageCost(grid=cost) for cost in (0.5, 8.0, 30.0)
)


class ElasticPhase(NamedTuple):
    """Velocity field of solids."""

    phase: int
    density: float  # [kg/m3] of a full cell
    wave_speed: float  # [m/s] largest of compression waves
    poisson_ratio: float

    @property
    def shear_part(self) -> float:
        """Return mu over the modulus of compression waves, lambda + 2 mu."""
        return (1.0 - 2.0 * self.poisson_ratio) / (2.0 * (1.0 - self.poisson_ratio))

    @property
    def trace(self) -> float:
        """Return minus lambda over mu, see kernels/grid/cell_stiffness.py."""
        return -2.0 * self.poisson_ratio / (1.0 - 2.0 * self.poisson_ratio)


class ImplicitElasticityPlan(FeaturePlan):
    """Implicit elasticity of a run.

    Attributes:
        solids: Velocity fields of solids.
    """

    name, title = "implicit_elasticity", "implicit elasticity"

    def __init__(
        self, solids: tuple[ElasticPhase, ...], phases: int, bounds: list[tuple[float, str]],
        has_pressure: bool, porous: frozenset[str],
    ):  # fmt: skip
        """Take what `plan_implicit_elasticity` finds; `phases` is their number."""
        self.solids, self.count, self.step_bounds = solids, phases, bounds
        self.has_pressure, self.porous = has_pressure, porous
        self.min_rate = max((1.0 / step for step, _ in bounds), default=0.0)

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return what it costs per particle of a solid.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        if not group.wave.on_grid:
            return None
        if not self.has_pressure:
            return costs.separate_stress + SWEEP_COST
        is_porous = group.material in self.porous
        return costs.separate_stress + (SWEEP_COST_OF_PORES if is_porous else SWEEP_COST_IN_LIQUID)

    def stress_proximity(self) -> StressProximity:
        """Return that solids sum their stress impulses separately wherever they are."""
        none, pairs = np.zeros((self.count, self.count), bool), np.ones((self.count,) * 2, bool)
        own = np.isin(np.arange(self.count), [solid.phase for solid in self.solids])
        # ranks with liquid alone at a node read the volume of another rank's solid there
        read = own | self.has_pressure
        return StressProximity(none, pairs, np.zeros(self.count, bool), read)

    def has_gather_kind(self, group: GroupPlan) -> bool:
        """Return whether the grid slows the waves of a group."""
        return group.wave.on_grid

    def gather_kind(self, group: GroupPlan, nodes: dict, dt: float, patch: int) -> Any:
        """Return the kind of such a group, whose waves bound no step of its particles.

        Args:
            group, nodes, dt, patch: See `FeaturePlan.gather_kind`.
        """
        from vgmpi.kernels.transfer.auxiliary_gather import WavesOnGrid  # it compiles

        return WavesOnGrid(type(group.law[0])(0.0))

    def start(self, context: Any) -> Any:
        """Return the implicit elasticity as it acts in a run, or None without a solid.

        Args:
            context: See `FeaturePlan.start`.
        """
        if not self.solids:
            return None
        from .coupling import ImplicitElasticity  # they compile
        from .solid_system import join_solids

        return ImplicitElasticity(context, join_solids(context, self.solids))


def plan_implicit_elasticity(draft: PlanDraft) -> tuple[ImplicitElasticityPlan, PlanDraft]:
    """Plan the implicit elasticity of a scene.

    Args:
        draft: Phases and groups.

    Returns:
        Its plan, and the draft with groups whose stress impulses are summed separately.
    """
    scene = draft.scene
    distance = scene.accuracy.elastic_courant_number * scene.domain.cell
    solids: dict[int, ElasticPhase] = {}
    groups, waves = [], {}
    for group in draft.groups:
        if group.is_liquid or group.is_carried:
            groups.append(group)
            continue
        groups.append(group._replace(separates_stress=True, wave=group.wave._replace(on_grid=True)))
        material: Any = scene.material[group.material]
        wave2 = float(law_function(group.law, "wave_speed2")(group.law, group.reference))
        own = ElasticPhase(
            group.phase, group.density, math.sqrt(wave2 * material.stiffening),
            getattr(material, "poisson_ratio", 0.25),
        )  # fmt: skip
        waves[f"waves of material {group.material!r}"] = distance / own.wave_speed
        other = solids.get(group.phase, own)
        solids[group.phase] = ElasticPhase(
            group.phase, min(own.density, other.density),
            max(own.wave_speed, other.wave_speed), max(own.poisson_ratio, other.poisson_ratio),
        )  # fmt: skip
    phases = tuple(solids[p] for p in sorted(solids))
    plan = ImplicitElasticityPlan(
        phases,
        len(draft.phases),
        [(step, cause) for cause, step in waves.items()],
        scene.accuracy.pressure == "implicit",
        frozenset(name for each in scene.coupling if each.rule == DRAG for name in each.between),
    )
    return plan, draft._replace(groups=tuple(groups))
