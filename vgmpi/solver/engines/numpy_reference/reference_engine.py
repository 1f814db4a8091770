"""Reference engine: the method of docs/explanation in plain NumPy; slow, for tests and for reading.

Each phase has one dense array over all nodes; all particles of a group are processed at once, in
double precision, on one rank and thread. The rest of the program only gives the particles and the
segments with a separate stress impulse (the tables); there are no patches, reproducible sums or
compiled code. Jiang 2015 (APIC), Hu 2018, Zhu and Bridson 2005 (FLIP).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from vgmpi.features.active_feature import (
    ActiveFeature,
    DenseStage,
    NodeState,
    carrier_of,
    reserved_nodes,
)
from vgmpi.kernels.colliders.moving_colliders import MovingColliders
from vgmpi.kernels.colliders.static_colliders import StaticColliders
from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR
from vgmpi.kernels.rigid.prescribed_motion import PhaseMotions
from vgmpi.kernels.step_records import AccumulatorOverflow, StepReport
from vgmpi.kernels.transfer.transfer_correction import CorrectionKinds
from vgmpi.materials.material import law_function
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.parallel.halo_exchange import FieldMessage
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.engine_protocol import CollidersAtNodes
from vgmpi.solver.engines.numpy_reference.liquid_volume import (
    cell_divergence,
    density_corrected_gradient,
    sum_cell_pressure,
    with_divergence,
    without_spray_divergence,
)
from vgmpi.solver.engines.plan_tables import phase_sets

from .advection import advect
from .collider_hold import ColliderHold
from .contact import Contact
from .dense_grid import CarriedFields, Dense, NodalSums, Stencil, mean_velocities, stencil_of
from .group_channels import (
    get_channel,
    kirchhoff_stress,
    law_in_doubles,
    law_state,
    put_channel,
    put_law_state,
    resolved_surface,
)
from .prescribed_motion import carry, distance_from_colliders, nearest_collider, prescribe
from .reaction_impulses import ReactionSums, WallRecorder
from .surface_nodes import SurfaceNodes
from .yielding_walls import sums_of


class Numpy(SurfaceNodes):
    """Particles and nodes of the domain; see solver/engines/engine_protocol.py."""

    words = 1

    def __init__(
        self, plan: Plan, lattice: BlockLattice, solids: CollidersAtNodes | None,
        threads: int = 1,
        driven: PhaseMotions | None = None,
    ):  # fmt: skip
        super().__init__(plan, Dense(plan))
        self.driven = driven
        self.features: Mapping[str, ActiveFeature] = {}  # of the run, set by the simulation
        self.groups = [ParticleGroup(group, lattice, plan.real) for group in plan.groups]
        self.contact = Contact(plan, self.dense)
        self.contact.motions = self.contact.motions if driven is None else driven.motions
        self.contact.is_free = getattr(solids, "is_free", self.contact.is_free)
        self.movers = solids if isinstance(solids, MovingColliders) else None
        if isinstance(solids, StaticColliders):
            self.contact.set_rigid(*solids.surface(self.dense.points()))
        stages = (feature.dense_stage(plan, self.dense) for feature in plan.features)
        self.stages: list[DenseStage] = [stage for stage in stages if stage is not None]
        self.sums: ReactionSums | None = None
        self.separates_stress = any(group.separates_stress for group in plan.groups)
        self.carried = CarriedFields(plan, self.dense)
        self.correction: CorrectionKinds | None = None  # of a feature, in a step of no time
        self.dense_correction: Any = None

    def open(self, wall: int) -> None:
        """Remove a wall that has vanished."""
        self.remove_wall(wall)
        axis, side = divmod(wall, 2)
        kind, _ = self.dense.walls[wall]
        self.dense.open(wall)
        if kind != "open":
            self.contact.open(axis, side)

    def enable_reactions(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        """Start to sum reactions.

        Args:
            rows, quanta, rank: See `EngineServices.enable_reactions`.
        """
        self.sums = self.contact.reactions = ReactionSums(self.plan, self.dense, rows, quanta)
        self.sum_reactions(rows, quanta, rank)

    def take_reactions(self) -> np.ndarray:
        """Return the reactions summed since the last call, shape (rows, 7) int64."""
        assert self.sums is not None
        return self.sums.take() + self.take_surface_reactions()

    def record(self, p: int, share: float, mass: np.ndarray | None = None) -> WallRecorder | None:
        """Return the recorder of wall reactions on a phase, None where not requested."""
        driven = self.plan.phases[p].driven  # prescribed motion has no reaction
        return None if self.sums is None or driven else WallRecorder(self.sums, p, share, mass)

    def set_topology(self, tables: ExchangeTopology, unchanged: bool = False) -> None:
        """Mark the particles whose stress impulse is summed separately, after a sort."""
        if tables.shared:
            raise RuntimeError("the numpy engine runs on one rank")
        self.set_node_blocks(tables)
        split = tables.contributes.get("impulses", np.zeros(len(tables.code), bool))
        self.split = [  # (particles,) bool by group
            np.repeat(split[tables.group == g], group.count) for g, group in enumerate(self.groups)
        ]

    def begin(
        self, dt: float, gravity: np.ndarray, speed: float,
        correction: CorrectionKinds | None = None,
    ) -> None:  # fmt: skip
        """Begin a step.

        Args:
            dt, gravity, speed, correction: See `Engine.begin`.
        """
        self.correction = correction
        self.dt, self.gravity, self.mirrors, self.change_share = dt, gravity, 1.0, 0.0
        if self.sums is not None:
            self.mirrors, self.change_share = self.sums.mirror_shares(dt)

    def pack(self, part: FieldMessage) -> None:
        """Raise an error: there are no other ranks."""
        raise RuntimeError("the numpy engine runs on one rank")

    add = pack

    def fill(self, border: bool) -> None:
        """Sum mass, momentum, separate impulses, volumes, offsets, carried values of each phase."""
        if border:
            return
        # In a step of no time stress gives no impulse, and the other sums are not read.
        n, shape = len(self.plan.phases), self.dense.shape
        self.nodes = NodalSums(n, shape, self.dt)
        self.carried.clear()
        self.begin_fields()
        if self.sums is not None:
            self.sums.mass.clear()
        self.stencils = [stencil_of(group, self.plan.dx) for group in self.groups]
        for g, group in enumerate(self.groups):
            if not group.plan.carrier:
                self._contribute(group, self.stencils[g], self.split[g])
        for p in range(n):
            record, fold = self.record, self.dense.fold
            if not self.dense.yields(p):
                fold(
                    self.nodes.momentum[p],
                    self.nodes.mass[p],
                    recorder=record(p, self.mirrors),
                    phase=p,
                )
                fold(self.nodes.forces[p], None, recorder=record(p, 1.0), phase=p)
            fold(None, self.nodes.counted[p], phase=p)
            fold(self.nodes.shear[p], None, phase=p)
            fold(self.nodes.offset[p], self.nodes.volume[p], kind="slip", phase=p)

    def _contribute(self, group: ParticleGroup, stencil: Stencil, split: np.ndarray) -> None:
        plan, dense, p = group.plan, self.dense, group.plan.phase
        v, C, vol0 = (get_channel(group, name) for name in ("v", "C", "vol0"))
        state, law = law_state(group), law_in_doubles(group)
        m = plan.density * vol0[:, 0]
        J = np.broadcast_to(law_function(law, "volume_ratio")(law, state), m.shape)
        affine = m[:, None, None] * C.reshape(-1, 3, 3) if self.plan.affine else None
        into = sums_of(self, group, stencil)
        dense.sum(into.mass, into.stencil, m[:, None])
        dense.sum(into.momentum, into.stencil, m[:, None] * v, affine)
        if plan.driven:  # stress does not move prescribed bodies
            split = np.zeros(len(m), bool)
        tau = self.dt * vol0[:, :, None] * kirchhoff_stress(law, state, C) * (not plan.driven)
        if plan.stores_porosity:
            tau = np.where(split[:, None, None], tau / get_channel(group, "share")[:, :, None], tau)
        if plan.volume.by_cells:
            tau = sum_cell_pressure(into.pressure, into.stencil, tau)
        separate = split[:, None, None]
        dense.sum_forces(into.momentum, into.stencil, np.where(separate, 0.0, tau))
        if self.separates_stress:
            dense.sum_forces(into.forces, into.stencil, np.where(separate, tau, 0.0))
            dense.sum(self.nodes.counted[p], stencil, np.where(split, J * vol0[:, 0], 0.0)[:, None])
        into.finish()
        if plan.surface:
            normal, distance, curve, certainty = resolved_surface(group, self.plan.dx)
            certainty = (m * certainty)[:, None]
            dense.sum(self.nodes.offset[p], stencil, certainty * normal, certainty[:, None] * curve)
            distance_moment = m[:, None] * distance[:, None]
            dense.sum(
                self.nodes.volume[p], stencil, distance_moment, m[:, None, None] * normal[:, None]
            )
            shear = np.einsum("nab,nb->na", C.reshape(-1, 3, 3), normal)
            dense.sum(self.nodes.shear[p], stencil, self.plan.dx * m[:, None] * shear)
        else:
            volume = plan.share * vol0 * (J[:, None] if plan.separates_stress else 1.0)
            dense.sum(self.nodes.volume[p], stencil, volume)
            # offset of the particle as seen from the node
            zeros = np.zeros((len(m), 3))
            dense.sum(self.nodes.offset[p], stencil, zeros, -volume[:, :, None] * np.eye(3))
        self.add_to_fields(group, stencil, self.dt)
        self.carried.sum(group, stencil, J * vol0[:, 0])

    def update(self, border: bool) -> None:
        """Compute nodal velocities (gravity, couplings, contact, walls) and mean values."""
        if border:
            return
        plan, dense, division = self.plan, self.dense, self._division()
        mass, volume, counted = (
            a[..., 0] for a in (self.nodes.mass, self.nodes.volume, self.nodes.counted)
        )
        floors = [NODE_MASS_FLOOR * phase.min_cell_mass for phase in plan.phases]
        min_mass = np.reshape(floors, (-1, 1, 1, 1))
        mass = np.where(mass > min_mass, mass, 0.0)
        some = mass[..., None] > 0
        summed = np.where(some, self.nodes.momentum / np.where(some, mass[..., None], 1.0), 0.0)
        if not self.dt:
            self.v = mean_velocities(summed, mass, phase_sets(plan))
            if division is not None:
                division.place()
                division.average(self.v, self.nodes.mass[..., 0])
            for p in range(len(plan.phases)):
                dense.mirror(self.v[p], p, self.record(p, self.mirrors))
            return
        v = np.where(some, summed + self.dt * self.gravity, 0.0)
        self._place_colliders()
        self.contact.along_walls(self.nodes.offset)
        if plan.separates_stress:  # what no feature distributes acts on its phase alone
            by_itself = np.ones(len(v), bool)
            for feature in plan.features:
                if feature.shared_stress is not None:
                    by_itself &= ~feature.shared_stress
            own = np.where(some, self.nodes.forces / np.where(some, mass[..., None], 1.0), 0.0)
            v[by_itself] += own[by_itself]
            self.nodes.forces[by_itself] = 0.0
        self.nodes.velocity_before = summed
        for stage in self.stages:
            stage.after_stress(self.nodes, v, mass)
        if division is not None:
            mass = self.nodes.mass[..., 0].copy()
            division.unite(v, mass, self.nodes.offset, self.nodes.volume)
            some = mass[..., None] > 0
        heavy = mass.copy()
        if self.driven is not None:
            prescribe(v, heavy, self.driven.motions, dense.points(), plan.dx)
        slope = np.where(some, self.nodes.shear / np.where(some, mass[..., None], 1.0), 0.0)
        self.contact_count = self.contact.apply(
            v, mass, heavy, self.nodes.offset, volume, slope, self.dt
        )
        holds = [ColliderHold(self, p, v, mass, volume) for p in range(len(v))]
        for p, hold in enumerate(holds):
            dense.constrain(v[p], p, self.record(p, 1.0, mass[p]), hold)
        if division is not None:
            division.part(v)
        for stage in self.stages:
            v = stage.after_walls(self.nodes, v, mass)
        self.v = v
        self.carried.average()

    def _division(self) -> Any:
        """Return how a feature divides nodes between phases, or None."""
        if self.contact.division is None:
            divisions = (each.divide_dense_nodes(self.dense) for each in self.features.values())
            self.contact.division = next((each for each in divisions if each is not None), None)
        return self.contact.division

    def _place_colliders(self) -> None:
        """Tell the contact where moving colliders, divided and attached nodes are."""
        if (division := self.contact.division) is not None:
            division.place()
            self.contact.set_rigid(division.collider, division.collider_number, division.moves)
        elif self.movers is not None:
            table, points = self.movers.table, self.dense.points()
            self.contact.set_rigid(*nearest_collider(table, points, self.dt, self.plan.dx))
        if (marks := reserved_nodes(self.features)) is not None:
            self.contact.reserved = self.dense_marks(marks)

    def begin_impulses(self) -> NodeState:
        """Refuse: features that filter stress impulses need the CPU engine."""
        raise NotImplementedError("no feature of this engine filters stress impulses")

    def begin_coupling(self) -> NodeState:
        """Copy what couplings need to node blocks, and return these."""
        self.copy_to_blocks(self.v, self.nodes.mass, self.nodes.offset, self.nodes.volume)
        return self.node_state()

    def end_coupling(self) -> None:
        """Copy the velocities that these kernels have changed from node blocks."""
        self.copy_from_blocks(self.v)

    def _gathered_fields(self) -> list[tuple[np.ndarray, float]]:
        """Return the velocity fields that particles gather, and the share they take of each."""
        fields = [(self.v, self.mirrors)]
        for stage in self.stages:
            fields += stage.gathered_fields(self.change_share)
        return fields

    def gather(self, step: int) -> StepReport:
        """Update velocities, gradients, states and positions; return what bounds the next step."""
        for fields, share in self._gathered_fields():
            for p in range(len(self.plan.phases)):
                recorder = self.record(p, share) if share else None
                self.dense.mirror(fields[p], p, recorder)
        reports = [self._gather(*each, step) for each in zip(self.groups, self.stencils, self.split,
                                                             strict=True)]  # fmt: skip
        failed = [row for report in reports for row in report.failures]
        rate, stray = (max(getattr(r, name) for r in reports) for name in ("rate", "stray"))
        # Turn and stress only serve the quanta of sums, which do not exist here.
        speeds, _, _ = zip(*(report.bounds for report in reports), strict=True)
        bounds = max(speeds), 0.0, 0.0
        return StepReport(rate, stray, bounds, failed, [])

    def correct_transfers(self, times: int) -> list[AccumulatorOverflow]:
        """Add `times` the motion that a step of no time has taken from the particles."""
        own = self.correction
        if own is not None:
            distance = distance_from_colliders(self.movers, self.dense, self.contact.collider)
            correction = self._dense_correction()
            correction.begin(
                self.nodes.mass, self.groups, self.stencils, distance, self.contact.division
            )  # fmt: skip
        for g, (group, stencil) in enumerate(zip(self.groups, self.stencils, strict=True)):
            if len(group) and not group.plan.is_carried:
                field, dense = self.v[group.plan.phase], self.dense
                L = dense.gather_slopes(field, stencil).reshape(-1, 9)
                for name, gathered in (("v", dense.gather(field, stencil)), ("C", L)):
                    current = get_channel(group, name)
                    put_channel(group, name, current + times * (current - gathered))
                if own is not None and g in own.groups:
                    correction.apply(group, stencil, own.particles)
        return []

    def _dense_correction(self) -> Any:
        """Return how a feature takes part in steps of no time."""
        if self.dense_correction is None:
            own = (feature.dense_correction(self.dense) for feature in self.features.values())
            self.dense_correction = next(each for each in own if each is not None)
        return self.dense_correction

    def _gather(
        self, group: ParticleGroup, stencil: Stencil, split: np.ndarray, step: int
    ) -> StepReport:
        plan, dense, p = group.plan, self.dense, group.plan.phase
        if not len(split):
            return StepReport(0.0, 0.0, (0.0,) * 3, [], [])
        if plan.is_carried:
            carrier: Any = carrier_of(self.features, plan.carrier) or self.driven
            row = -1 if carrier is None else carrier.row_of_group(self.groups.index(group), p)
            return carry(group, carrier.motions, row, dense.dx, self.dt, step)
        self.carried.gather(group, stencil)
        v, L = dense.gather(self.v[p], stencil), dense.gather_slopes(self.v[p], stencil)
        trace, transport = np.abs(np.trace(L, axis1=1, axis2=2)), v
        new_velocity = v
        for stage in self.stages:
            new_velocity = stage.particle_velocity(group, stencil, v, self.dt)
        put_channel(group, "v", new_velocity)
        put_channel(group, "C", L.reshape(-1, 9))
        for stage in self.stages:
            transport, L = stage.motion(group, stencil, split, transport, L)
        if plan.volume.by_cells:
            L = with_divergence(L, cell_divergence(self.v[p], stencil))
        if plan.volume.inverse_cell_mass:
            J = np.exp(get_channel(group, "theta")[:, 0])
            L = density_corrected_gradient(
                dense, self.nodes.mass[p], stencil, plan.volume.inverse_cell_mass, J, L
            )
        if plan.volume.softens_spray:
            L = without_spray_divergence(L, self._fill_fraction(group, stencil))
        law, rows = law_in_doubles(group), tuple(L.reshape(-1, 9).T)
        state = law_function(law, "advance")(law, law_state(group), rows, self.dt)
        put_law_state(group, state)
        if plan.tracks_deformation:
            F = np.eye(3) + get_channel(group, "F").reshape(-1, 3, 3)
            C = get_channel(group, "C").reshape(-1, 3, 3)
            put_channel(group, "F", (F + self.dt * C @ F - np.eye(3)).reshape(-1, 9))
        return advect(group, self.plan, self.dt, transport, trace, law, state, step)

    def _fill_fraction(self, group, stencil) -> np.ndarray:
        """Return the filled fraction of the space around the particles of a liquid."""
        p, dense = group.plan.phase, self.dense
        for stage in self.stages:
            if (fraction := stage.fill_fraction(group, stencil)) is not None:
                return fraction
        mass = dense.complete_wall_mass(self.nodes.mass[p])
        return dense.gather(mass, stencil)[:, 0] / (group.plan.density * dense.dx**3)
