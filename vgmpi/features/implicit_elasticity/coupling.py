"""Implicit elasticity in a step: the nodes of a solid answer to impulses together.

With the masses M of the nodes and an isotropic stiffness K of the cells, as stiff as the solid, an
impulse r changes the velocities by (M + beta dt2 K)^-1 r. K feels neither translations nor turns:
momentum stays. It multiplies the change of velocity and not the velocity: waves that are shorter
than the way of some steps are slowed, neither damped nor unstable, at any length of the step.
See docs/explanation/implicit-elasticity.md.

References:
    Olovsson, Simonsson and Unosson 2005: Selective mass scaling for explicit finite element
    analyses. Int. J. Numer. Meth. Eng. 63, 1436-1445.
"""

from collections.abc import Sequence

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, NodeState, StartContext
from vgmpi.kernels.step_records import StepSpan
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.runtime.aligned_arrays import aligned_zeros

from .kernels import solid_sweeps
from .solid_system import SolidSystem


class ImplicitElasticity(ActiveFeature):
    """Implicit elasticity at the nodes of a rank."""

    filters_impulses = True

    def __init__(self, context: StartContext, systems: Sequence[SolidSystem]):
        """Take what may change in a run, and the systems of its solids."""
        plan = self.plan = context.plan
        self.ranks, self.systems = context.ranks, systems
        pairs, own = plan.pair_rules, [part.phase for system in systems for part in system.parts]
        touches = pairs is None or bool((pairs[own] == CONTACT).sum() > len(own))
        stops = any(kind == "separate" for kind, _ in plan.walls.solids)
        self.couples_nodes = plan.collider or stops or (plan.contact.has_pairs and touches)
        self.deformable_solids = systems

    def set_topology(self, tables: ExchangeTopology, census: BlockDirectory) -> None:
        """Take new tables after a sort.

        Args:
            tables: Topology of this rank.
            census: Segments of this rank and nearby ones.
        """
        for system in self.systems:
            system.set_topology(tables, census)
        sizes = [192 * (len(system.rows) + 1) for system in self.systems]
        self.impulses, self.expected = (
            [aligned_zeros(size, self.plan.real) for size in sizes] for _ in range(2)
        )

    def filter_stress(self, nodes: NodeState, span: StepSpan) -> None:
        """Let the stress impulses act on the nodes of each solid together.

        Args:
            nodes: Nodes of the rank.
            span: The step.
        """
        nodal, real = nodes.fields["impulses"].nodes, self.plan.real.type
        parts = zip(self.systems, self.impulses, self.expected, strict=True)
        for system, impulses, expected in parts:
            system.begin(nodes, span.dt)
            for part in system.parts:
                nodes.call(
                    solid_sweeps.take_impulses, part.rows, system.nodes,
                    real(1.0 / part.mass_of_cell), nodal, impulses,
                )  # fmt: skip
            w = system.answer(impulses)
            reactions = system.find_reactions(impulses, w)
            for part in system.parts:
                nodes.call(
                    solid_sweeps.store_impulses, part.rows, system.nodes, real(part.mass_of_cell),
                    w, reactions, system.fields, nodes.velocities, nodal,
                )  # fmt: skip
            rows = np.arange(len(system.rows))
            nodes.call(
                solid_sweeps.expect_velocities, rows, system.nodes, nodes.velocities, w, expected
            )

    def couple_nodes(self, nodes: NodeState, span: StepSpan, gravity: np.ndarray) -> None:
        """Let the impulses of contact act on the nodes of each solid together.

        Contact, and walls that let go, have stopped single nodes: a kink that would be an error of
        the stress.

        Args:
            nodes, span, gravity: See `ActiveFeature.couple_nodes`.
        """
        parts = zip(self.systems, self.impulses, self.expected, strict=True)
        for system, impulses, expected in parts:
            impulses[:] = 0
            touches = np.zeros(1, np.int64)
            nodes.call(
                solid_sweeps.take_contact, system.occupied_rows, system.nodes,
                nodes.walls.cells, nodes.velocities, system.fields, expected, impulses, touches,
            )  # fmt: skip
            if self.ranks.max(touches.astype(float))[0] > 0:
                w = system.answer(impulses)
                nodes.call(
                    solid_sweeps.spread_contact, system.occupied_rows, system.nodes, w,
                    system.fields, impulses, nodes.velocities,
                )  # fmt: skip
