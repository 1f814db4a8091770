"""Plan of phases that share space: rules of their interaction, groups, nodal values and bounds."""

from typing import Any

import numpy as np

from vgmpi.materials.couplings.interaction import CONTACT, DRAG, MIXING
from vgmpi.materials.material import law_function
from vgmpi.parallel.exchange_topology import StressProximity
from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft, PoreDrag
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.step_costs import ProximityCost, StepCosts
from vgmpi.scene.scene import Scene

from .rules import (
    InteractionRules,
    interaction_rules,
    rules_without_drag,
    with_slip_wave_factors,
)

FLUX, DRIFT = "flux", "drift"  # nodal volume flux and drift [m/s], for particles


class MixturesPlan(FeaturePlan):
    """Phases of a run that share space.

    With an implicit pressure, which finds what sands and the liquids in their pores do to each
    other, only mixtures of liquids remain.

    Attributes:
        rules: Their interaction.
        acting_rules: What of it acts here.
    """

    name = title = "mixtures"
    gathers_with_stress = counts_volumes = True
    pair_channels = {"mixing": "", "drag": "share"}

    def __init__(
        self, rules: InteractionRules, bounds: list[tuple[float, str]], cell: float,
        finds_volumes: bool,
    ):  # fmt: skip
        """Take the rules and what follows from them.

        Args:
            rules: Rules of the interaction.
            bounds: Bounds of the time step [s] with their causes.
            cell: Cell size [m].
            finds_volumes: Whether the volumes of the fluids follow from the flux of all phases;
                with an implicit pressure they do not.
        """
        self.rules, self.step_bounds, self.cell = rules, bounds, cell
        self.min_rate = 6.0 * float(rules.diffusion.max(initial=0.0)) / cell**2
        self.drifts = bool(rules.conservative_drift.any())
        self.finds_volumes = finds_volumes
        self.acting_rules = rules if finds_volumes else rules_without_drag(rules)
        if not finds_volumes:
            self.pair_channels = {}
            if rules.has_drag:
                is_porous = rules.drag.any(1) & ~rules.fluid
                self.pore_drag = PoreDrag(
                    rules.drag, rules.porosity, np.where(is_porous, rules.volume, 0.0)
                )
        self.gathered = (FLUX,) * finds_volumes + (DRIFT,) * self.drifts
        self.slip_relaxation = rules.slip_relaxation
        self.pair_rules, self.phase_sets = rules.pair, rules.phase_sets
        shares_space = self.acting_rules.mixture_set >= 0
        self.shared_stress = shares_space & rules.fluid
        self.grain_volumes = np.where(shares_space & ~rules.fluid, rules.volume, 0.0)

    def stress_proximity(self) -> StressProximity | None:
        """Return near which phases stress impulses are summed separately."""
        if not self.acting_rules.sets:
            return None
        rules, is_same = self.acting_rules, np.eye(len(self.rules.fluid), dtype=bool)
        same_mixture = rules.mixture_set[:, None] == rules.mixture_set[None, :]
        shares_space = same_mixture & (rules.mixture_set >= 0)[:, None] & ~is_same
        needs_contact = (rules.pair == CONTACT) & ~is_same
        needs_contact |= (rules.pair == MIXING) & rules.drifting[:, None]
        return StressProximity(
            shares_space, needs_contact, rules.fluid, np.zeros(len(rules.fluid), bool)
        )

    def pair_cost(self, p: int, q: int, costs: StepCosts) -> tuple[str, ProximityCost] | None:
        """Return the name and the cost of the interaction of two phases that share space.

        Args:
            p, q, costs: See `FeaturePlan.pair_cost`.
        """
        rule = self.rules.pair[p, q]
        if rule == CONTACT:
            return None
        return ("mixing", costs.mixing) if rule == MIXING else ("drag", costs.drag)

    def gathers(self, group: GroupPlan) -> tuple[str, ...]:
        """Return what the particles of a fluid that shares space gather."""
        return self.gathered if group.shares_space else ()

    def gather_kind(self, group: GroupPlan, nodes: dict, dt: float, patch: int) -> Any:
        """Return the kind with which they gather it.

        Args:
            group, nodes, dt, patch: See `FeaturePlan.gather_kind`.
        """
        from .gather import OVERFILL_RELAXATION_RATE, MixtureGather

        if not self.finds_volumes:
            from .drift import DriftGather

            return DriftGather(nodes[DRIFT], patch)
        real, wave = type(group.law[0]), group.wave
        values = (
            group.channels.first("share"), self.cell, OVERFILL_RELAXATION_RATE, wave.factor,
            wave.density_ratio, wave.added,
        )  # fmt: skip
        drift = nodes[DRIFT if self.drifts else FLUX]
        return MixtureGather(nodes[FLUX], drift, int(self.drifts), *map(real, values))

    def node_stage(self, nodes: dict) -> Any:
        """Return the stage of the grid update.

        Args:
            nodes: See `FeaturePlan.node_stage`.
        """
        if not self.acting_rules.sets:
            return None
        from .kernels import MixtureStage
        from .workspace import mixture_tables

        if self.finds_volumes:
            flux = nodes[FLUX]
        else:
            flux = np.zeros((0, 256), next(iter(nodes.values())).dtype)
        drift = nodes[DRIFT] if self.drifts else flux
        return MixtureStage(flux, drift, mixture_tables(self.acting_rules))

    def start(self, context: Any) -> Any:
        """Return the drift as it acts in a run beside an implicit pressure, or None.

        Args:
            context: See `FeaturePlan.start`.
        """
        if self.finds_volumes or not self.drifts:
            return None
        from .drift import MixtureDrift  # it compiles

        return MixtureDrift()

    def stage_scratch(self, phases: int, real: np.dtype) -> Any:
        """Return scratch of one thread for it.

        Args:
            phases, real: See `FeaturePlan.stage_scratch`.
        """
        from .workspace import mixture_workspace

        return mixture_workspace(phases, real)

    def dense_stage(self, plan: Any, dense: Any) -> Any:
        """Return the same for the reference engine.

        Args:
            plan, dense: See `FeaturePlan.dense_stage`.
        """
        from .reference import DenseMixtures

        densities = np.array([phase.min_cell_mass for phase in plan.phases]) / plan.dx**3
        return DenseMixtures(self.rules, densities, dense)


def plan_mixtures(draft: PlanDraft) -> tuple[MixturesPlan | None, PlanDraft]:
    """Plan the phases of a scene that share space.

    Args:
        draft: Phases and groups.

    Returns:
        The plan, None without couplings of such phases, and the draft with their groups.
    """
    scene = draft.scene
    rules = interaction_rules(scene, draft.groups, draft.phases)
    if rules is None:
        return None, draft
    cell, finds_volumes = scene.domain.cell, not scene.is_free_of_waves
    acting = rules if finds_volumes else rules_without_drag(rules)
    groups = tuple(_with_shared_space(scene, group, acting) for group in draft.groups)
    groups = with_slip_wave_factors(groups, acting, scene.courant_number * cell)
    used = {group.material for group in groups}
    bounds = [
        (
            cell**2 / (6.0 * coupling.diffusivity),
            "the diffusion of materials {!r} and {!r}".format(*coupling.between),
        )
        for coupling in scene.coupling
        if coupling.rule == MIXING
        and coupling.diffusivity > 0
        and used.issuperset(coupling.between)
    ]
    return MixturesPlan(rules, bounds, cell, finds_volumes), draft._replace(groups=groups)


def _with_shared_space(scene: Scene, group: GroupPlan, rules: InteractionRules) -> GroupPlan:
    """Return the group with what it needs to share space with other phases."""
    if rules.mixture_set[group.phase] < 0 or not rules.fluid[group.phase]:
        return group
    group = group._replace(separates_stress=True, shares_space=True)
    for coupling in scene.coupling:
        if coupling.rule == DRAG and group.material in coupling.between:
            sand = scene.material[next(m for m in coupling.between if m != group.material)]
            reference = tuple(v for values in sand.carries.values() for v in values)
            law, wave = sand.law(), group.wave
            water = scene.material[group.material].model_copy(update={"tension": "off"}).law()
            real = type(group.law[0])
            wave = wave._replace(
                min_porosity=min(wave.min_porosity, sand.porosity),
                added=max(wave.added, float(law_function(law, "wave_speed2")(law, reference))),
                density_ratio=max(wave.density_ratio, group.density / sand.density),
            )
            # water in pores bears no tension
            group = group._replace(law=type(water)(*(real(v) for v in water)), wave=wave)
    return group
