"""Plan of an optional feature: what the rest of a plan must know of it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from vgmpi.scene.rigid_motion import Trajectory
from vgmpi.scene.scene_feature import features

from .step_costs import COSTS, ProximityCost, StageCost, StepCosts

TIME_TOLERANCE = 1.0 + 1e-12  # [-] ratio below which two times count as equal


class ReleaseLayer(NamedTuple):
    """Horizontal layer of a body, released as a whole."""

    time: float  # [s] of the release
    low: float = -math.inf  # [m] range of heights
    high: float = math.inf


class ReleasedParticles(NamedTuple):
    """Particles of a group that join another one at given times."""

    group: int
    group_after_release: int
    course: Trajectory | None  # their motion before; None: they are at rest
    layers: tuple[ReleaseLayer, ...]  # in order of time; empty if they are never released


class BodyPart(NamedTuple):
    """Part of a body whose particles have a group of their own."""

    object: int  # row of the body
    particles: int  # number of its particles
    group: int  # their group


class Adhesion(NamedTuple):
    """Adhesion of the flow of each phase to surfaces."""

    # (surfaces, phases) [m] slip lengths, inf: free slip. Surfaces are colliders or phases
    lengths: tuple[tuple[float, ...], ...]
    viscosities: tuple[float, ...]  # (phases,) [Pa s] dynamic viscosity


class SlipRelaxation(NamedTuple):
    """Relaxation of the relative motion of phases that share space."""

    sets: np.ndarray  # (phases,) number of the mixture, or -1
    times: np.ndarray  # (phases,) [s] relaxation time of the velocity relative to the mixture's


class PoreDrag(NamedTuple):
    """Drag of liquids that flow through the pores of sands."""

    coefficients: np.ndarray  # (phases, phases) [kg/(m3 s)], 0 where there is none
    porosity: np.ndarray  # (phases,) [-] volume fraction of pores in a sand
    grain_volumes: np.ndarray  # (phases,) [m3/kg] of a sand with such pores, 0 of other phases


class FeaturePlan:
    """Feature of a run, one of `Plan.features`. Every answer has a default: nothing is needed.

    Attributes:
        name: Name of the feature.
        title: Noun phrase for reports.
        gathered: Names of auxiliary nodal values that particles gather for it.
        nodal_fields: Names of the fields near surfaces that it reads at nodes.
        reads_at_colliders: Whether it reads them only at nodes next to colliders that it moves.
        phases: Phases whose particles contribute to them.
        phases_in_contact: Those of these phases that contribute wherever other phases are near.
        reads_all_nodes: Whether it needs contributions also at nodes that touch no such collider.
        adhesion: Adhesion of flows to each collider, or None if they slip freely on all.
        numbers_colliders: Whether it must know which collider a node is close to.
        collider_cost: What it costs close to colliders, besides these, relative to a fluid's step.
        moved_colliders: Number of colliders that it moves by what acts on them.
        collider_title: What reports call these.
        counted: What reports count where there are no particles: number, singular, plural.
        has_momentum: Whether momentum and energy of its own are in the conservation log.
        step_limit: What makes steps shorter than at the start, for reports, or "".
        added_phases: Number of phases, the last ones, that are no bodies' own.
        joins_compilation: Whether a run that only compiles kernels, without colliders and prepared
            data, has it.
        step_seconds: Processor time [s] of a step besides that of its particles.
        uncounted_groups: Groups whose momentum and energy something else counts.
        drives_motion: Whether bodies reach speeds that gravity alone does not give them.
        source_names: Names of its particle sources, see scene/scene_feature.py.
        source_speeds: Speeds [m/s] with which their particles enter.
        removes_particles: Whether particles leave the domain.
        correction_interval: See `ActiveFeature`.
        particle_channels: Channels of particles that it adds.
        frame_bytes: Bytes that it adds to a particle in frames.
        summed_fields: Number of nodal fields that it sums everywhere.
        separates_stress: Whether it sums all stress impulses separately from momentum.
        shared_stress: Phases whose stress impulses it distributes, (phases,) bool, or None.
        grain_volumes: Specific volume of the grains of sands with fluids in their pores, 0 of
            other phases, (phases,) [m3/kg], or None.
        gathers_with_stress: Whether particles gather its values only where impulses are separate.
        counts_volumes: Whether it needs volumes at the nodes where stress impulses are separate.
        pair_rules: Interaction of each two phases, (phases, phases), CONTACT or another number of
            materials/couplings/interaction.py; None if all are in contact.
        pair_channels: Channels that its interactions need, by their names in reports; "": none.
        slip_relaxation: Relaxation of relative motion that it applies, or None.
        pore_drag: Drag in sands that it leaves to an implicit pressure, or None.
        phase_sets: Phases of one number share one velocity, -1: each its own, (phases,), or None.
        min_rate: Lower bound of 1 / dt [1/s].
        step_bounds: Bounds of the time step [s] and their causes.
    """

    name = title = ""
    gathered: tuple[str, ...] = ()
    nodal_fields: frozenset[str] = frozenset()
    reads_at_colliders = numbers_colliders = has_momentum = False
    phases: frozenset[int] = frozenset()
    reads_all_nodes, joins_compilation = False, True
    phases_in_contact: frozenset[int] = frozenset()
    adhesion: Adhesion | None = None
    collider_cost: ProximityCost | None = None
    moved_colliders = added_phases = 0
    step_seconds = 0.0
    collider_title = step_limit = ""
    counted = 0, "", ""
    uncounted_groups: frozenset[int] = frozenset()
    drives_motion = removes_particles = False
    source_names: tuple[str, ...] = ()
    source_speeds: tuple[float, ...] = ()
    correction_interval = summed_fields = frame_bytes = 0
    particle_channels: tuple[str, ...] = ()
    separates_stress = gathers_with_stress = counts_volumes = False
    shared_stress: np.ndarray | None = None
    grain_volumes: np.ndarray | None = None
    pair_rules: np.ndarray | None = None
    pair_channels: Mapping[str, str] = {}
    phase_sets: np.ndarray | None = None
    slip_relaxation: SlipRelaxation | None = None
    pore_drag: PoreDrag | None = None
    min_rate = 0.0
    step_bounds: Sequence[tuple[float, str]] = ()

    def contributes(self, phase: int) -> bool:
        """Return whether the particles of a phase contribute to its nodal fields."""
        return phase in self.phases

    def field_requests(self, plan: Any) -> tuple:
        """Return its features/field_request.py `FieldRequest`s, for fields of its own.

        Args:
            plan: The plan of the run.
        """
        return ()

    def gathers(self, group: Any) -> tuple[str, ...]:
        """Return the names of the auxiliary nodal values that the particles of a group gather."""
        return ()

    def has_gather_kind(self, group: Any) -> bool:
        """Return whether the particles of a group have a `gather_kind` of its own."""
        return bool(self.gathers(group))

    def gather_kind(self, group: Any, nodes: dict, dt: float, patch: int) -> Any:
        """Return the kernels/transfer/auxiliary_gather.py kind of such a group.

        Args:
            group: The `GroupPlan`.
            nodes: Auxiliary nodal values by name.
            dt: Length of the step [s].
            patch: Number of its first patch among the auxiliary ones.
        """
        return None

    def node_stage(self, nodes: dict) -> Any:
        """Return its kernels/grid/node_stages.py kind, or None.

        Args:
            nodes: Auxiliary nodal values by name.
        """
        return None

    def stage_scratch(self, phases: int, real: np.dtype) -> Any:
        """Return scratch of one thread for that kind, or None. One feature of a run has some.

        Args:
            phases: Number of phases.
            real: Type of the numbers.
        """
        return None

    def dense_stage(self, plan: Any, dense: Any) -> Any:
        """Return its features/active_feature.py `DenseStage` for the reference engine, or None.

        Args:
            plan: The plan of the run.
            dense: See `ActiveFeature.divide_dense_nodes`.
        """
        return None

    def stress_proximity(self) -> Any:
        """Return near which phases it sums stress impulses separately, or None.

        The result is a parallel/exchange_topology.py `StressProximity`.
        """
        return None

    def retained_share(self, dt: float) -> float:
        """Return the share of the motion that the grid does not resolve, which particles retain.

        Args:
            dt: Length of the step [s].
        """
        return 0.0

    def pair_cost(self, p: int, q: int, costs: StepCosts) -> tuple[str, ProximityCost] | None:
        """Return name and cost of the interaction of two phases, None if it is contact.

        Args:
            p, q: The phases.
            costs: Costs of the parts of a step.
        """
        return None

    def particle_cost(self, group: Any, costs: StepCosts) -> StageCost | None:
        """Return what it costs per particle of a group, relative to a fluid's step, or None.

        Args:
            group: The `GroupPlan`.
            costs: Costs of the parts of a step.
        """
        return None

    def parts(self) -> list[BodyPart]:
        """Return the parts of bodies that have groups of their own."""
        return []

    def assign_groups(self, ids: np.ndarray, groups: np.ndarray) -> None:
        """Set the groups of particles at the start.

        Args:
            ids: Particle ids, shape (n,).
            groups: Their groups (in/out), shape (n,).
        """

    def released_particles(self) -> list[ReleasedParticles]:
        """Return the particles that join another group at a time."""
        return []

    def groups_after_release(self) -> dict[int, int]:
        """Return the group that each of its whole bodies joins at a time, by the body's row."""
        return {}

    def reserved_bytes(self, plan: Any) -> int:
        """Return the memory [bytes] of particles that have space in a second group."""
        return 0

    def courses(self) -> list[tuple[Trajectory, float]]:
        """Return the motion of each body that it moves, and its largest radius [m]."""
        return []

    def phase_motions(self, plan: Any, first_row: int) -> Any:
        """Return the velocities of the phases that it prescribes, or None if it prescribes none.

        Args:
            plan: The plan of the run.
            first_row: Row of its first reaction.

        Returns:
            Something with the attributes of a kernels/rigid/prescribed_motion.py `PhaseMotions`.
        """
        return None

    def may_hold(self, group: int, usual: np.ndarray) -> np.ndarray:
        """Return which particles may have come to a group because of the feature, (n,) bool.

        Args:
            group: Number of the group.
            usual: Groups in which the particles begin, shape (n,).
        """
        return np.zeros(len(usual), bool)

    def inserted_counts(self, time: float) -> dict[int, int]:
        """Return the particles that each of its sources has inserted up to a time [s], by row."""
        return {}

    def mean_counts(self, plan: Any) -> dict[int, int]:
        """Return the mean number of particles of each of its sources over the run, by row."""
        return {}

    def reaction_bodies(self) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """Return (objects, reference point [m]) of each row of reactions that it adds."""
        return []

    def report_lines(self, plan: Any) -> list[str]:
        """Return its lines of the plan report."""
        return []

    def warning_lines(self, plan: Any) -> list[str]:
        """Return a line on each thing of it that will hardly do what is meant."""
        return []

    def for_compilation(self) -> "FeaturePlan | None":
        """Return the plan of a run that only compiles kernels, or None to leave it out."""
        return self if self.joins_compilation else None

    def moved_bodies(self, colliders: list) -> Any:
        """Return the state of the colliders that it moves, or None if it moves none.

        It has their `rows`, `place(table)`, `matrices()`, `speeds()`, `travel`, `note_search()` and
        `restore_search(saved)`; kernels/colliders/moving_colliders.py calls these.

        Args:
            colliders: All colliders at the start.
        """
        return None

    def start(self, context: Any) -> Any:
        """Return the feature as it acts in a run, an `ActiveFeature`, or None if kinds are all.

        Args:
            context: What it may take, a features/active_feature.py `StartContext`.
        """
        return None


class PlanDraft(NamedTuple):
    """Draft of a plan, which features may change: phases and groups, those of features last."""

    scene: Any
    phases: tuple  # of `PhasePlan`
    groups: tuple  # of `GroupPlan`
    group_of: tuple[int, ...]  # group of each entity of the scene, -1 without particles
    particle_counts: list[int]  # of each entity
    features: tuple[FeaturePlan, ...] = ()  # planned so far


def plan_features(draft: PlanDraft, prepared: Mapping[str, Any], precede_copies: bool) -> PlanDraft:
    """Return the draft with the plans of features that a scene has, and their changes.

    Features plan in three rounds: those that change groups which others copy (one call, before the
    corrections of transfers are added), then those that move whole bodies to groups of their own,
    then the rest. Each round has the order of the list.

    Args:
        draft: Phases and groups without these features.
        prepared: Prepared data of features by name.
        precede_copies: Which features are planned, see `SceneFeature.precedes_copies`.
    """
    for feature in sorted(features(), key=lambda each: not each.moves_bodies):
        if feature.precedes_copies != precede_copies:
            continue
        plan, draft = feature.plan(draft, prepared.get(feature.name))
        if plan is not None:
            groups = tuple(_with_price(group, plan) for group in draft.groups)
            draft = draft._replace(groups=groups, features=(*draft.features, plan))
    return draft


def _with_price(group: Any, plan: FeaturePlan) -> Any:
    """Return a group whose work per particle includes what a feature costs."""
    price = plan.particle_cost(group, COSTS)
    return group if price is None else group._replace(cost=group.cost + price.total)


def first_reaction_rows(plans: Iterable[FeaturePlan], first: int) -> dict[str, int]:
    """Return the row of the first reaction of each feature, by name.

    Args:
        plans: Plans of the features.
        first: Row of the first reaction of all.
    """
    rows = {}
    for plan in plans:
        rows[plan.name] = first
        first += len(plan.reaction_bodies())
    return rows
