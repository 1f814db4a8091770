"""Features as they act in a run: when each method is called, and what it may read and change.

A step calls, in the order of `Simulation.features`,

    begin_step; push_particles; [particles to grid, exchange]; filter_stress; [grid update];
    couple_nodes; end_coupling; [grid to particles]; end_step; request; [maxima over all ranks];
    failure; adjust_bounds; needs_sort

A sort calls place, the feature with blocks (where it has `phases`), set_topology and
find_particles. The start of a run calls initial_particles and begin_run, a restart restore.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from vgmpi.kernels.kernel_arguments import NodeBlocks, Walls
from vgmpi.kernels.step_records import ParticleBounds, StepMaxima, StepReport, StepSpan
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.feature_plan import first_reaction_rows
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan
from vgmpi.scene import scene_feature

from .particle_insertion import ParticleRows


class StartContext(NamedTuple):
    """All that a feature may take when a run starts."""

    plan: Plan
    lattice: BlockLattice
    ranks: SerialCommunicator
    groups: list[ParticleGroup]
    colliders: Sequence  # as prepared
    collider_nodes: Any  # colliders at the nodes (MovingColliders, StaticColliders), or None
    movers: Any  # colliders that are evaluated in every step (MovingColliders), or None
    prescribed: Any  # phases whose velocity a feature prescribes (PhaseMotions), or None
    threads: int
    first_reaction_row: int  # row of its first reaction
    features: Mapping[str, "ActiveFeature"]  # of the run; those before it have started
    engine: "EngineServices"
    insert: Callable[[list[ParticleRows]], ParticleBounds]  # inserts particles; a sort must follow
    move_particles: Callable[[], None]  # to be called after particles were removed


class EngineServices(Protocol):
    """Requests of features to an engine; all else they do to nodes and particles themselves."""

    def open(self, wall: int) -> None:
        """Remove a wall (0 to 5: west, east, south, north, floor, roof) that has vanished."""

    def enable_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum the reactions of colliders and walls.

        Args:
            rows: Number of bodies: colliders, then walls.
            quanta: Quanta of the fixed-point sums, shape (7,). They change from step to step.
            rank: This rank.
        """

    def take_reactions(self) -> np.ndarray:
        """Return the reactions summed on this rank since the last call.

        Returns:
            Impulse, its moment about the domain's origin, and work in quanta, shape (rows, 7)
            int64; colliders come first, then walls.
        """


class NodeState(NamedTuple):
    """Nodes of a rank after the grid update: all that a coupling may read or change."""

    velocities: np.ndarray  # (node blocks, 256) velocity [m/s] and mass [kg] (in/out)
    fields: Mapping[str, Any]  # nodal field -> its `tables` (kernel_arguments.Sums) and `nodes`
    gathered: Mapping[str, np.ndarray]  # further values that particles gather (in/out), by name
    tables: ExchangeTopology
    blocks: NodeBlocks
    block_rows: Sequence[np.ndarray]  # rows of blocks of each thread
    phases: Any  # PhaseTable
    walls: Walls
    reactions: Sequence[Any]  # sums of reactions by thread (in/out), each None if none are summed
    each: Callable  # each(task, *arguments) calls task(thread, *arguments) on every thread
    call: Callable  # call(kernel, rows, *arguments) runs compiled code if there are rows


class AdheringNodes(NamedTuple):
    """Nodes that stick to free bodies: with velocities v these take impulses b - A v."""

    matrix: np.ndarray  # (6 m, 6 m) A
    momentum: np.ndarray  # (6 m,) b
    number: int  # number of nodes on this rank
    sums: np.ndarray  # sums over the nodes of all ranks, of which the two are made


class PushedBodies(Protocol):
    """Free rigid bodies as what pushes them in a step sees them; all ranks hold the same.

    Attributes:
        number_of: Number of the free body of each collider, -1 if it is not free, (colliders,).
    """

    number_of: np.ndarray

    def centers(self) -> np.ndarray:
        """Return their centers of mass, shape (m, 3) [m]."""

    def predict_velocities(self, dt: float, gravity: np.ndarray) -> np.ndarray:
        """Return the velocities after a step without what pushes them, shape (m, 6) [m/s], [rad/s].

        Args:
            dt: Length of the step [s].
            gravity: Acceleration, shape (3,) [m/s2].
        """

    def mobility(self) -> np.ndarray:
        """Return the changes of the velocities per impulse, (6 m, 6 m) [1/kg], [1/(kg m)], ..."""

    def add_impulses(self, impulses: np.ndarray) -> None:
        """Give them impulses and moments about their centers, (m, 6) [kg m/s], [kg m2/s]."""

    def sum_adhesion(self, nodes: NodeState, dt: float) -> AdheringNodes | None:
        """Return the nodes that stick to them, or None if liquids slip. Collective.

        Args:
            nodes: Nodes of the rank.
            dt: Length of the step [s].
        """

    def apply_adhesion(
        self, nodes: NodeState, dt: float, adhering: AdheringNodes, v: np.ndarray
    ) -> None:
        """Give nodes that stick to them their impulses, and them the reactions. Collective.

        Args:
            nodes, dt: See `sum_adhesion`.
            adhering: Its result.
            v: Velocities of the bodies, shape (m, 6) [m/s], [rad/s].
        """


class DeformableSolid(Protocol):
    """Phase of solids whose nodes answer to impulses together, in a step of the grid.

    Attributes:
        phase: The phase.
        occupied_rows: Numbers of those of its system's blocks that have nodes at which impulses
            reach it.
        mass_of_cell: Mass of a full cell [kg].
    """

    phase: int
    occupied_rows: np.ndarray
    mass_of_cell: float


class DeformableSolids(Protocol):
    """System of phases of solids that answer to impulses in one solution, each on its own.

    Attributes:
        rows: Rows of its blocks among the node blocks of the rank, shape (n,).
        block_of: Rows of its blocks among the blocks of the rank, shape (n,).
        is_attached: 1 for nodes at which impulses reach a solid, flat, 64 of a block.
        loose: 1 for the directions in which no wall holds a node, flat, 192 of a block.
        uptake: Impulse over mass and change of velocity of a node, flat, 64 of a block: 1, but vast
            where something holds it.
    """

    rows: np.ndarray
    block_of: np.ndarray
    is_attached: np.ndarray
    loose: np.ndarray
    uptake: np.ndarray

    @property
    def parts(self) -> Sequence[DeformableSolid]:
        """Return the phases."""

    def carry(self, masses: np.ndarray) -> np.ndarray:
        """Let the nodes carry masses besides their own in all further answers of the step.

        Collective.

        Args:
            masses: Per mass of a full cell, flat, 64 of a block and the row of no block.

        Returns:
            Rough changes of velocity per impulse, at each node alone, of the same shape.
        """

    def answer(self, impulses: np.ndarray) -> np.ndarray:
        """Return the changes of velocity by impulses, a symmetric operator. Collective.

        Args:
            impulses: Per mass of a full cell of each phase, flat, 192 of a block, axis after axis,
                and the row of no block.
        """


class WallInflow(NamedTuple):
    """Liquid that enters through a wall from one time to another."""

    nodes: np.ndarray  # (n, 3) nodes of the wall
    velocities: np.ndarray  # (n, 3) [m/s]
    begin: float  # [s]
    end: float  # [s]


class FilledNodes(NamedTuple):
    """Nodes that something at rest fills which is not on the grid."""

    nodes: np.ndarray  # (n, 3) nodes
    parts: np.ndarray  # (n,) [-] filled part of the space around each, in an unbounded domain
    row: int  # row of the reactions of what holds it


class ActiveFeature:
    """Feature of a run on one rank. Methods are collective; every one does nothing by default.

    Attributes:
        carrier: Value of `GroupPlan.carrier` of the groups whose particles it moves, or "".
        reserved_nodes: 1 at nodes that it attaches, where colliders do not act, (node blocks, 64)
            uint8; None if it attaches none.
        pushed_bodies: Free bodies that features which act before it may push, or None.
        wall_inflows: What enters through walls; the pressure must not hold it.
        attaches_to_bodies: Whether it attaches nodes to free rigid bodies: it has `find_contacts`.
        phases: Phases whose fields it needs near its blocks, shape (phases,) bool.
        filters_impulses: Whether it has `filter_stress`.
        deformable_solids: Phases of solids that answer to impulses at their nodes for features
            which act after it, or none.
        couples_nodes: Whether it has `couple_nodes`.
        has_request: Whether it has `request`.
        is_fixed: Whether the blocks near it stay the same, so that a sort may reuse the tables.
        correction_origin: Step from which the intervals of corrections are counted.
        correction_interval: Number of steps between two steps of no time in which it takes part by
            `correction_kinds`, 0: never. At most one feature of a run does.
        margin: Distance [cells] by which it may move particles after a step.
    """

    carrier = ""
    reserved_nodes: np.ndarray | None = None
    pushed_bodies: PushedBodies | None = None
    wall_inflows: Sequence[WallInflow] = ()
    attaches_to_bodies = False
    phases = np.zeros(0, bool)
    filters_impulses = False
    deformable_solids: Sequence[DeformableSolids] = ()
    couples_nodes = False
    has_request = False
    is_fixed = True
    correction_origin = 0
    correction_interval = 0
    margin = 0.0

    @property
    def filled_nodes(self) -> Sequence[FilledNodes]:
        """Return what keeps liquids with an implicit pressure out until the next sort."""
        return ()

    def compile_kernels(self) -> None:
        """Compile, by calls without rows, the kernels that a first step may not call."""

    # ---- start and restart -----------------------------------------------------------------------

    def initial_particles(self, rows: list[ParticleRows]) -> list[ParticleRows]:
        """Return the particles at the start, given those that it would be without the feature."""
        return rows

    def begin_run(self, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of all particles at the start, which are inserted."""
        return bounds

    def saved(self) -> dict[str, Any]:
        """Return attributes of a checkpoint with its state. Collective."""
        return {}

    def place_saved(self, attrs: dict, time: float) -> None:
        """Stand where it stood at the last sort, before the topology is restored."""

    def restore(self, saved: Any) -> None:
        """Restore its state from a checkpoint, after the topology."""

    # ---- a sort ----------------------------------------------------------------------------------

    def place(self, time: float) -> None:
        """Place it where it is at a time [s]."""

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables."""

    def find_particles(self, time: float) -> None:
        """Find its particles, which a sort or a removal has moved in memory."""

    # ---- an insertion of particles ---------------------------------------------------------------

    def assign_groups(self, group_of: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the groups of new particles (n,), given those of their objects.

        Args:
            group_of: Groups, shape (n,).
            x: Positions, shape (n, 3) [m].
        """
        return group_of

    def channel_values(self, group: GroupPlan, rows: ParticleRows) -> dict[str, np.ndarray]:
        """Return values of channels of new particles, shape (n, width), by name.

        Args:
            group: Plan of their group.
            rows: The particles.
        """
        return {}

    def count_inserted(self, rows: ParticleRows) -> None:
        """Count particles that were inserted on this rank."""

    def count_transferred(self, group: int, other: int, volume: np.ndarray) -> None:
        """Count particles that moved from one group to another on this rank.

        Args:
            group: Index of the group that they left.
            other: Index of the group that they joined.
            volume: Rest volumes, shape (n,) [m3].
        """

    def carried_particles(self, group: ParticleGroup) -> np.ndarray:
        """Return the indices (n,) of particles of a group that it carries for a time."""
        return np.zeros(0, np.int64)

    # ---- a step ----------------------------------------------------------------------------------

    def divide_phases(self, phases: Any) -> Any:
        """Return the constants of the phases with the nodes that it divides between them now.

        Args:
            phases: A kernels/grid/divided_nodes.py `Phases`.
        """
        return phases

    def divide_dense_nodes(self, dense: Any) -> Any:
        """Return how it divides the nodes of the reference engine between phases, or None.

        Args:
            dense: Nodes of the domain, a numpy_reference/dense_grid.py `Dense`.
        """
        return None

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s], at least `rate`, of the longest step that it allows at a time."""
        return rate

    def next_event(self, time: float, goal: float) -> float:
        """Return the time [s], at most `goal`, at which the steps must land next."""
        return goal

    def begin_step(self, span: StepSpan) -> None:
        """Begin a step."""

    def correction_kinds(self, dt: float, step: int) -> CorrectionKinds | None:
        """Return what it does in the step of no time before a step.

        Args:
            dt: Length of that step [s].
            step: Number of steps so far.
        """
        return None

    def dense_correction(self, dense: Any) -> Any:
        """Return how it takes part in a step of no time of the reference engine, or None.

        The result has `begin(mass, groups, stencils, distance, division)` and `apply(group,
        stencil, kind)`, see features/shifting/reference.py.

        Args:
            dense: See `divide_dense_nodes`.
        """
        return None

    def end_correction(self, time: float, moves: bool) -> None:
        """Follow a step of no time, which has changed velocities.

        Args:
            time: Time [s].
            moves: Whether features of the run may move particles in such steps.
        """

    def push_particles(self, span: StepSpan) -> float:
        """Change velocities before a step; return a bound [m/s] of what it adds, also by motion."""
        return 0.0

    def filter_stress(self, nodes: NodeState, span: StepSpan) -> None:
        """Change the separate stress impulses before they act.

        Args:
            nodes: Nodes of the rank; the velocities are those of momentum and gravity alone.
            span: The step.
        """

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Change the velocities of nodes after all that acts at each node alone.

        Args:
            nodes: Nodes of the rank.
            span: The step.
            gravity: Acceleration, shape (3,) [m/s2].
        """

    def hold_nodes(self, nodes: NodeState, span: StepSpan) -> None:
        """Give the nodes that it attaches their velocities, before those of others are found.

        Args:
            nodes: Nodes of the rank.
            span: The step.
        """

    def end_coupling(self, span: StepSpan) -> None:
        """Compute what follows from the velocities that all couplings have left."""

    def end_step(self, span: StepSpan, report: StepReport) -> StepReport:
        """Follow the particles; return the report of the step."""
        return report

    def request(self, span: StepSpan) -> float:
        """Return a number whose maximum over all ranks `needs_sort` takes."""
        return 0.0

    def failure(self) -> str:
        """Return the name of what has left the domain, or an empty text; equal on all ranks."""
        return ""

    def adjust_bounds(self, span: StepSpan, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of the next step, given those of the particles of all ranks."""
        return bounds

    def needs_sort(self, span: StepSpan, maxima: StepMaxima) -> bool:
        """Return whether a sort must follow; insert particles and move them between groups."""
        return False

    # ---- output ----------------------------------------------------------------------------------

    def frame_rows(self, group: ParticleGroup, indices: np.ndarray) -> dict[str, np.ndarray]:
        """Return datasets of particles (n,) of a group for a frame, by name; equal for all groups.

        Args:
            group: The group.
            indices: Indices of the particles, shape (n,).
        """
        return {}

    def collider_poses(self, time: float) -> np.ndarray | None:
        """Return the poses of moving colliders, shape (m, 4, 4), start -> `time` [m], or None."""
        return None

    def conserved(self, time: float) -> dict[str, float]:
        """Return columns of the conservation log that the particles do not have; on rank 0."""
        return {}

    def phase_entries(self) -> list[dict[str, float]]:
        """Return its columns of the conservation log by phase, or no rows. Collective."""
        return []

    def external_impulse(self, t0: float, t1: float) -> np.ndarray:
        """Return the impulse (3,) [N s] that it gave all particles between two times [s].

        It is that from outside, besides gravity and the reactions of colliders and walls.
        """
        return np.zeros(3)

    def reaction_points(self) -> np.ndarray:
        """Return the present reference points of its reactions, shape (rows, 3) [m]."""
        return np.zeros((0, 3))


class DenseStage:
    """Part of a feature in the grid update and in the gather of particles.

    It is for the reference engine what kernels/grid/node_stages.py is for the others.

    Every method by default changes nothing. Arrays run over phases, then nodes.
    """

    def after_stress(self, nodes: Any, v: np.ndarray, mass: np.ndarray) -> None:
        """Act after the separate stress impulses that no feature distributes.

        Args:
            nodes: Sums at the nodes: `forces` and `counted` are the separate impulses [kg m/s] and
                the volumes [m3], `offset` the field of offsets, `dt` [s] the length of the step.
            v: Velocities (in/out), shape (phases, ..., 3) [m/s].
            mass: Masses, shape (phases, ...) [kg].
        """

    def after_walls(self, nodes: Any, v: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """Act after contact and walls; return the velocities (phases, ..., 3) [m/s].

        Args:
            nodes, v, mass: See `after_stress`; `velocity_before` of the nodes are the velocities
                before gravity and stress [m/s].
        """
        return v

    def gathered_fields(self, change_share: float) -> list[tuple[np.ndarray, float]]:
        """Return the fields that particles gather, and the share of wall reactions in each.

        Args:
            change_share: Share of the mirror's change of velocity that reaches particles.
        """
        return []

    def particle_velocity(
        self, group: ParticleGroup, stencil: Any, v: np.ndarray, dt: float
    ) -> np.ndarray:
        """Return the velocities that particles take, shape (n, 3) [m/s].

        Args:
            group: The particles.
            stencil: Their stencil.
            v: Velocities as gathered [m/s].
            dt: Length of the step [s].
        """
        return v

    def motion(
        self, group: ParticleGroup, stencil: Any, split: np.ndarray, v: np.ndarray, L: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the velocities (n, 3) [m/s] that advect particles, and the gradients for laws.

        Args:
            group, stencil: See `particle_velocity`.
            split: Particles whose stress impulses are summed separately, shape (n,) bool.
            v, L: Velocities, and gradients (n, 3, 3) [1/s], as gathered.
        """
        return v, L

    def fill_fraction(self, group: ParticleGroup, stencil: Any) -> np.ndarray | None:
        """Return the filled fraction of the space around particles (n,), None if masses tell it.

        Args:
            group, stencil: See `particle_velocity`.
        """
        return None


def carrier_of(features: Mapping[str, ActiveFeature], name: str) -> ActiveFeature | None:
    """Return the feature that moves the groups of a `GroupPlan.carrier`; None for ""."""
    return next((each for each in features.values() if name and each.carrier == name), None)


def reserved_nodes(features: Mapping[str, ActiveFeature]) -> np.ndarray | None:
    """Return the nodes that features attach, (node blocks, 64) uint8, or None."""
    marks = [each.reserved_nodes for each in features.values() if each.reserved_nodes is not None]
    return np.maximum.reduce(marks) if marks else None


def start_features(context: StartContext, features: dict[str, ActiveFeature]) -> None:
    """Start the features of a plan on this rank, in the order in which they act.

    Args:
        context: What they may take.
        features: The features by name (out).
    """
    plans = {plan.name: plan for plan in context.plan.features}
    rows = first_reaction_rows(context.plan.features, context.first_reaction_row)
    for name in (feature.name for feature in scene_feature.features()):
        if name in plans:
            feature = plans[name].start(context._replace(first_reaction_row=rows[name]))
            if feature is not None:
                features[name] = feature
