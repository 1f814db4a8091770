"""Nodes next to rigid surfaces, in the layout of the kernels that couple them with the grid.

Slip, free rigid bodies and other features act on nodes and not on particles. Every
engine calls the same kernels for them. Here the dense arrays of the reference engine are copied to
node blocks and back; the nodal fields of these kernels are sums over dense arrays as all others.
"""

import numpy as np

from vgmpi.features.active_feature import NodeState
from vgmpi.kernels.grid.contact_impulses import contact_workspace
from vgmpi.kernels.kernel_arguments import NodeBlocks, Sums
from vgmpi.parallel.exchange_topology import GRADIENTS, ExchangeTopology
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.kernel_caller import KernelCaller
from vgmpi.solver.engines.nodal_field_storage import (
    fields_near_colliders,
    near_colliders_of_group,
)
from vgmpi.solver.engines.plan_tables import open_wall, phase_table, wall_table
from vgmpi.solver.engines.reaction_sums import ReactionAccumulators

from .dense_grid import Dense, Stencil
from .group_channels import get_channel, kirchhoff_stress, law_in_doubles, law_state


class BlockField:
    """Values of one nodal field at the nodes of node blocks, `nodes` (node blocks, 256)."""

    def __init__(self, count: int):
        """Create the field for a number of node blocks."""
        self.nodes = np.zeros((count, 256))
        none = np.zeros((0, 2, 16))
        self.tables = Sums(np.zeros((0, 2, 256)), none, np.zeros(0, np.uint8), self.nodes)


class SurfaceNodes(KernelCaller):
    """Node blocks of the domain and what kernels of rigid surfaces need of an engine."""

    def __init__(self, plan: Plan, dense: Dense):
        """Take the walls and phases of a plan."""
        super().__init__(1)
        self.plan, self.dense = plan, dense
        self.walls, self.phases = wall_table(plan), phase_table(plan)
        self.surface_fields = fields_near_colliders(plan)  # empty if no such kernel is called
        self.workspaces = [contact_workspace(len(plan.phases))]
        self.reactions: ReactionAccumulators | None = None
        self.layers: dict[str, BlockField] = {}
        self.dense_fields: dict[str, np.ndarray] = {}

    def remove_wall(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        open_wall(self.walls, wall)

    def sum_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum the reactions of rigid surfaces.

        Args:
            rows, quanta, rank: See `EngineServices.enable_reactions`.
        """
        self.reactions = ReactionAccumulators(self.plan, rows, quanta, rank, 1)

    def set_node_blocks(self, tables: ExchangeTopology) -> None:
        """Allocate the node blocks after a sort, and find their nodes in dense arrays."""
        if not self.surface_fields:
            return
        self.entries, self.tables = {}, tables
        none = np.zeros(0, np.int64)
        self.blocks = NodeBlocks(
            tables.first, tables.phase, tables.coordinates, tables.may_touch, tables.solid,
            np.zeros(len(tables.phase) + 1, np.int64), none,
        )  # fmt: skip
        block = np.repeat(tables.coordinates, np.diff(tables.first), axis=0)
        self.inside, index = self.dense.nodes_of_blocks(block)
        phase = np.broadcast_to(tables.phase[:, None], self.inside.shape)
        self.index = phase[self.inside], *index
        names = "momentum", "offsets", *self.surface_fields
        self.layers = {name: BlockField(len(tables.phase)) for name in names}
        if self.reactions is not None:
            self.reactions.set_topology(tables)
            self.workspaces = self.reactions.attach_to_workspaces(self.workspaces)

    def begin_fields(self) -> None:
        """Begin the sums of the fields near surfaces."""
        shape = len(self.plan.phases), *self.dense.shape, 4
        self.dense_fields = {name: np.zeros(shape) for name in self.surface_fields}

    def add_to_fields(self, group: ParticleGroup, stencil: Stencil, dt: float) -> None:
        """Add a group's particles: dx times the velocity gradient, and the mean pressure.

        Args:
            group: Particles.
            stencil: Their stencil.
            dt: Length of the step [s].
        """
        names = near_colliders_of_group(self.plan, group.plan)
        if not names:
            return
        C, vol0 = get_channel(group, "C").reshape(-1, 3, 3), get_channel(group, "vol0")
        mass, dx = group.plan.density * vol0, self.dense.dx
        for axis, name in enumerate(names):
            if name in GRADIENTS:
                values = np.hstack([dx * mass * C[:, :, axis], mass])
            else:
                law, state = law_in_doubles(group), law_state(group)
                tau = kirchhoff_stress(law, state, C.reshape(-1, 9))
                pressure = -np.trace(tau, axis1=1, axis2=2)[:, None] / 3.0
                values = np.hstack([dt / dx * vol0 * pressure, np.zeros((len(vol0), 2)), vol0])
            self.dense.sum(self.dense_fields[name][group.plan.phase], stencil, values)

    def copy_to_blocks(self, velocity: np.ndarray, mass, offset, volume) -> None:
        """Copy dense arrays to node blocks.

        Args:
            velocity: Velocities, shape (phases, ..., 3) [m/s].
            mass: Masses, shape (phases, ..., 1) [kg].
            offset, volume: See `Contact.apply`, shapes (phases, ..., 3) and (phases, ..., 1).
        """
        fields = {
            "momentum": np.concatenate([velocity, mass], -1),
            "offsets": np.concatenate([offset, volume], -1),
        }
        for name, values in (fields | self.dense_fields).items():
            self.layers[name].nodes.reshape(-1, 64, 4)[self.inside] = values[self.index]

    def copy_from_blocks(self, velocity: np.ndarray) -> None:
        """Copy the velocities of node blocks to a dense array (phases, ..., 3) [m/s]."""
        nodes = self.layers["momentum"].nodes.reshape(-1, 64, 4)
        velocity[self.index] = nodes[self.inside, :3]

    def node_state(self) -> NodeState:
        """Return the node blocks for what couples them."""
        return NodeState(
            self.layers["momentum"].nodes, self.layers, {}, self.tables, self.blocks,
            [np.arange(len(self.tables.coordinates))], self.phases, self.walls,
            [workspace.reactions for workspace in self.workspaces], self.each, self.call,
        )  # fmt: skip

    def dense_marks(self, marks: np.ndarray) -> np.ndarray:
        """Return marks of nodes, shape (node blocks, 64), as dense array (phases, ...) bool."""
        out = np.zeros((len(self.plan.phases), *self.dense.shape), bool)
        out[self.index] = marks[self.inside] != 0
        return out

    def take_surface_reactions(self) -> np.ndarray | int:
        """Return the reactions summed since the last call, shape (rows, 7) int64."""
        return 0 if self.reactions is None else self.reactions.take()
