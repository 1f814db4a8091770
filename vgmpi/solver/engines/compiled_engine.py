"""What engines of compiled kernels share: their arrays, the tables after a sort, the reactions."""

from collections.abc import Mapping

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState
from vgmpi.kernels.grid.node_stages import SeparatedStress
from vgmpi.kernels.kernel_arguments import NodeBlocks, Step, Sums
from vgmpi.kernels.reaction_impulses import GhostNodes
from vgmpi.kernels.rigid.prescribed_motion import PhaseMotions
from vgmpi.kernels.step_records import AccumulatorOverflow
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.kernels.wall_boundary import patch_codes
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan

from . import surface_fields
from .engine_protocol import CollidersAtNodes
from .group_context import GroupContext, group_context, lowest_overflow
from .kernel_caller import KernelCaller
from .nodal_field_storage import NodalField, NodalFields
from .plan_tables import open_wall, plan_tables, wall_kinds_of
from .reaction_sums import ReactionAccumulators
from .thread_memory import ThreadMemory, ThreadPartition, accumulator_copies


class CompiledEngine(KernelCaller):
    """Particles and nodes of one rank.

    Attributes:
        features: Features of the run, set by the simulation.
        groups: Particles.
        solids: Colliders at the nodes.
        driven: Prescribed bodies.
        plan_tables: Tables of the plan that kernels read.
        layers: Nodal fields.
        memory: Scratch memory of the threads, and what they report.
        parts: Tables of the groups, as `tables`, `blocks`, `block_shares` and `merged_rows` of the
            nodes for the present topology.
        dt: Length of the present step [s]; `step`, `correction` and `flags` are its constants.
    """

    GROUP, LAYER = ParticleGroup, NodalField  # array classes, replaced by other engines

    def __init__(
        self, plan: Plan, lattice: BlockLattice, solids: CollidersAtNodes | None,
        threads: int = 1,
        driven: PhaseMotions | None = None,
    ):  # fmt: skip
        super().__init__(threads)
        self.plan, self.solids, self.driven = plan, solids, driven
        self.features: Mapping[str, ActiveFeature] = {}
        self.groups = [self.GROUP(group, lattice, plan.real) for group in plan.groups]
        self.plan_tables = plan_tables(plan, driven, solids)
        self.layers = NodalFields(plan, self.LAYER)
        self.words = self.layers.words
        self.correction: CorrectionKinds | None = None  # of a feature, in a step of no time
        self.memory = ThreadMemory(plan, threads, self.layers)
        self.reactions: ReactionAccumulators | None = None
        self.parts: list[GroupContext] = []

    def enable_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum the reactions of colliders and walls.

        Args:
            rows, quanta, rank: See `EngineServices.enable_reactions`.
        """
        self.reactions = ReactionAccumulators(self.plan, rows, quanta, rank, self.threads)

    def take_reactions(self) -> np.ndarray:
        """Return the reactions summed since the last call, shape (rows, 7) int64."""
        assert self.reactions is not None
        return self.reactions.take()

    # ---- after a sort ----------------------------------------------------------------------------

    def set_topology(self, tables: ExchangeTopology, unchanged: bool = False) -> None:
        """Allocate nodes and segment tables after a sort; unchanged tables keep sums and copies."""
        self.entries = {}
        rows = [np.flatnonzero(tables.group == g) for g in range(len(self.groups))]
        for group, group_rows in zip(self.groups, rows, strict=True):
            if not np.array_equal(tables.code[group_rows], group.code):
                raise RuntimeError(f"group {group.plan.name}: segments do not match the census")
        if unchanged:
            self.parts = [
                part._replace(segments=part.segments._replace(start=g.start, count=g.count))
                for part, g in zip(self.parts, self.groups, strict=True)
            ]
            return
        self.tables = tables
        partitions = [
            ThreadPartition(group.count, tables.border[group_rows], self.threads)
            for group, group_rows in zip(self.groups, rows, strict=True)
        ]
        target, copied, copy_rows = accumulator_copies(tables, rows, partitions, self.threads)
        self.blocks = NodeBlocks(
            tables.first,
            tables.phase,
            tables.coordinates,
            tables.may_touch,
            tables.solid,
            copied,
            copy_rows,
        )
        phase_of_row = np.concatenate([tables.phase, np.repeat(tables.phase, np.diff(copied))])
        self.layers.set_topology(tables, phase_of_row)
        self.block_shares = ThreadPartition(
            np.diff(tables.first), tables.receives_remote, self.threads
        )
        sent = [link.send_blocks for links in tables.shared.values() for link in links.values()]
        self.merged_rows = np.unique(np.concatenate([np.zeros(0, np.int64), *sent]))
        if self.reactions is not None:
            self.reactions.set_topology(tables)
            workspaces = self.reactions.attach_to_workspaces(self.memory.workspaces)
            self.memory.workspaces = workspaces
        self.parts = []
        for group, own, partition in zip(self.groups, rows, partitions, strict=True):
            context = group_context(
                self.layers.requests, group, tables, own, target[own], partition,
                self._mirror(group), self.reactions,
            )  # fmt: skip
            self.parts.append(context)
        surface_fields.restrict_offsets(self)

    def open(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        open_wall(self.plan_tables.walls, wall)
        for part in self.parts:
            part.segments.mirror[:] = self._mirror(part.group)

    def _mirror(self, group: ParticleGroup) -> np.ndarray:
        """Return the codes of the walls that a group's segments meet."""
        kinds = wall_kinds_of(self.plan_tables.walls, self.plan.phases[group.plan.phase])
        return patch_codes(group.block, self.plan.cells, kinds)

    # ---- a step ----------------------------------------------------------------------------------

    def begin(
        self, dt: float, gravity: np.ndarray, speed: float,
        correction: CorrectionKinds | None = None,
    ) -> None:  # fmt: skip
        """Choose the quanta of the sums of a step.

        Args:
            dt, gravity, speed, correction: See `Engine.begin`.
        """
        self.dt, self.correction = dt, correction
        for scratch in self.memory.scratch:
            scratch.peak[:] = 0.0
        velocity_step = np.zeros(4, self.plan.real)
        velocity_step[:3] = dt * gravity
        self.step = Step(dt, self.plan.dx, velocity_step)
        self.layers.begin(speed)
        self.flags = surface_fields.surface_flags(self)

    def _is_summed(self, name: str) -> bool:
        """Return whether particles contribute to a nodal field in the present step."""
        if name == "momentum":
            return True
        if name in self.layers.requests.timeless:
            return self.correction is not None
        return bool(self.dt)

    def begin_impulses(self) -> NodeState:
        """Refuse: features that filter stress impulses need the CPU engine."""
        raise NotImplementedError("no feature of this engine filters stress impulses")

    def begin_coupling(self) -> NodeState:
        """Convert the sums that only couplings read to numbers, and return the nodes."""
        self.layers.finalize_for_couplings(self.blocks, self.memory.overflow[0])
        return self.node_state()

    def node_state(self) -> NodeState:
        """Return the nodes as they are."""
        return NodeState(
            self.layers["momentum"].nodes, self.layers, self.layers.gathered_nodes, self.tables,
            self.blocks,
            self.block_shares.all, self.plan_tables.phases, self.plan_tables.walls,
            [workspace.reactions for workspace in self.memory.workspaces], self.each, self.call,
        )  # fmt: skip

    def end_coupling(self) -> None:
        """Do nothing: the nodes have their velocities."""

    def separated_stress(
        self, shared: np.ndarray, stage: tuple, scratch: tuple
    ) -> SeparatedStress | None:
        """Return separate stress impulses, None if momentum has all.

        Args:
            shared: Phases whose impulses a feature distributes, of the plan's tables.
            stage: Kind of the stages of features.
            scratch: Scratch of a thread for them.
        """
        if not self.layers.separates_stress:
            return None
        impulses, adds_own = self.layers["impulses"].tables, self.plan_tables.adds_own_stress
        return SeparatedStress(
            impulses, shared, adds_own, stage, scratch, int(self.filters_impulses)
        )  # fmt: skip

    @property
    def filters_impulses(self) -> bool:
        """Return whether a feature changes the stress impulses of this step before the update."""
        return bool(self.dt) and any(each.filters_impulses for each in self.features.values())

    @property
    def timeless_field(self) -> tuple[Sums | None, int]:
        """Sums of the field that steps of no time have besides momentum, if any, and its number."""
        for name in self.layers.requests.timeless:
            return self.layers[name].tables, self.layers.numbers[name]
        return None, 0

    def _ghosts(
        self, part: GroupContext, thread: int, layer: str = "momentum"
    ) -> GhostNodes | None:
        """Return the ghost record of a transfer, None where reactions are not requested."""
        if self.reactions is None or part.ghosts is None or part.group.plan.is_carried:
            return None
        return self.reactions.ghosts_of_transfer(part.ghosts, thread, layer, self.dt)

    def _found_beyond(self) -> list[AccumulatorOverflow]:
        """Return the lowest node block of each field in which a sum left its range."""
        if not self.memory.overflow.any():
            return []
        layers = enumerate(self.layers)
        overflows = [
            lowest_overflow(self.memory.overflow[:, k], self.tables, name) for k, name in layers
        ]
        self.memory.overflow[:] = 0
        return [each for each in overflows if each is not None]
