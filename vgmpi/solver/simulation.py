"""One step of the coupled multiphase material point method, and the state that it advances."""

from collections.abc import Callable, Sequence

import numpy as np

from vgmpi.kernels.kernel_arguments import MAX_CELLS_PER_STEP
from vgmpi.kernels.rigid.moving_colliders import place_colliders
from vgmpi.kernels.rigid.prescribed_motion import PrescribedBodies
from vgmpi.kernels.transfer import g2p
from vgmpi.kernels.transfer.particle_shifting import MAX_SHIFT_CELLS
from vgmpi.parallel import exchange_topology, migration
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.halo_exchange import HaloExchange
from vgmpi.parallel.load_balance import SHARES, RankPace
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.plan import Plan
from vgmpi.solver.boundary.flow_accounting import Tally
from vgmpi.solver.boundary.free_body_coupling import free_body_coupling
from vgmpi.solver.boundary.inlets import Sources
from vgmpi.solver.boundary.load_application import Pushes
from vgmpi.solver.boundary.outlets import Sinks
from vgmpi.solver.boundary.particle_insertion import ParticleRows, bounds_of_idle_group, insert
from vgmpi.solver.boundary.pinned_coupling import make_pinned_parts
from vgmpi.solver.boundary.release import Releases
from vgmpi.solver.boundary.surface_coupling import make_couplings
from vgmpi.solver.boundary.wall_sides import MAX_PUSH_CELLS, wall_sides
from vgmpi.solver.diagnostics.reactions import Reactions
from vgmpi.solver.engines.engine_protocol import (
    UNKNOWN_MAXIMA,
    AccumulatorOverflow,
    Engine,
    ParticleMaxima,
    StepReport,
)
from vgmpi.solver.engines.shift_tables import shift_constants
from vgmpi.solver.steering.particle_changes import ParticleChanges

from .engine_registry import engine_of
from .failure_message import failure_message
from .topology_requirements import needs

MAXIMA_SLICE = [0, 3, 4, 5]  # indices of particle_insertion.bounds among a step's maxima


class BlowUp(RuntimeError):
    """Error of a state that can no longer be trusted; it names object, particle and step."""


class Simulation:
    """Particles of all groups on this rank, and the clock. All methods are collective.

    time [s] and step are the state's; rate [1/s] is the least 1/dt that the state allows;
    particle_maxima bounds the sums of the next step. All four are part of a checkpoint.
    """

    def __init__(
        self, plan: Plan, ranks: SerialCommunicator, colliders: Sequence = (), threads: int = 1,
        loads: Sequence = (), engine: str = "cpu",
    ):  # fmt: skip
        """Set up the engine and the features of the plan, without particles."""
        self.plan, self.ranks, self.pace = plan, ranks, RankPace(ranks)
        self.lattice = BlockLattice(plan.cells, plan.dx)
        # true if a collider has its own friction, is free, or its reaction is requested
        per_collider = len(plan.friction) > len(plan.phases) + 1 or plan.numbers_colliders
        solids = place_colliders(list(colliders), self.lattice, plan.real, per_collider)
        self.movers, self.solids = solids
        self.pins = make_pinned_parts(plan, self.lattice, self.movers, len(colliders), threads)
        self.driven = PrescribedBodies(plan, len(colliders)) if plan.driven else None
        self.motions = [m for m in (self.movers, self.driven, self.pins) if m is not None]
        rigid = self.solids, threads, self.driven
        self.engine: Engine = engine_of(engine)(plan, self.lattice, *rigid)
        self.engine.pins = self.pins
        self.groups: list[ParticleGroup] = self.engine.groups
        self.bodies = free_body_coupling(plan, self.movers, self.engine, ranks, self.pins)
        self.couplings = make_couplings(
            plan, self.lattice, self.solids, self.engine, ranks, self.pins, self.bodies
        )
        self.reactions = Reactions(plan, colliders, ranks) if plan.feels else None
        if self.reactions is not None:
            rows = len(self.reactions.totals)
            self.engine.enable_reactions(rows, self.reactions.quanta, ranks.rank)
        self.loads = Pushes(list(loads), plan, ranks) if loads else None
        self.changes: ParticleChanges | None = None  # by a program, between steps
        tally = self.flow_accounting = Tally(plan) if plan.is_open_system else None
        self.sides = wall_sides(plan, self.movers, self.groups, self.flow_accounting)
        self.sources = Sources(plan, ranks) if plan.sources else None
        self.sinks = Sinks(plan, tally) if tally is not None and plan.sinks else None
        releases = plan.has_releases
        self.releases = Releases(plan, self.flow_accounting, self.engine) if releases else None
        self.correction_origin_step = 0  # step of the last release: corrections are counted from it
        self.gravity = np.array(plan.gravity)
        self.needs = needs(plan)
        self.tables: exchange_topology.ExchangeTopology
        self.census: BlockDirectory
        self.cut: np.ndarray | None = None
        self.halo: HaloExchange | None = None
        self.correction_halo: HaloExchange | None = None  # exchange of zero-length steps
        self.time, self.step, self.rate, self.particle_maxima = 0.0, 0, 0.0, UNKNOWN_MAXIMA
        # the next shift must leave particles in their patches
        margin = 1.2 * MAX_SHIFT_CELLS if plan.shift_interval else 0.0
        margin += 1.2 * MAX_PUSH_CELLS if self.sides is not None else 0.0
        self.max_stray = g2p.MAX_STRAY_CELLS - margin
        self.sorts = self.sorted_at = 0
        self.sent = 0  # [bytes] sent to neighbors by this rank
        self.moved = 0  # particles that left this rank for another
        self.reduction_buffer = np.zeros(12)
        self.clock: Callable[[str], None] | None = None  # marks the end of a stage

    def put(
        self, x: np.ndarray, v: np.ndarray, volume: np.ndarray, ids: np.ndarray,
        owner: np.ndarray, theta: np.ndarray | None = None, C: np.ndarray | None = None,
        sh: np.ndarray | None = None, surface: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Insert the initial particles, unstrained or compressed. Collective; call it once.

        Their order and their distribution over the ranks do not matter. Particles of inlets are
        left out; the inlets spawn them.

        Args:
            x: Positions, shape (n, 3) [m].
            v: Velocities, shape (n, 3) [m/s].
            volume: Rest volumes, shape (n,) [m3].
            ids: Particle ids, shape (n,).
            owner: Object of each particle, shape (n,).
            theta: ln J of fluids, shape (n,), or None for 0.
            C: Velocity gradients, shape (n, 9) [1/s], or None for 0.
            sh: Colors, shape (n, K, 3); required if colors travel.
            surface: Surfaces of solids, shape (n, 10), see planning/particle_channels.py.

        Raises:
            ValueError: If contact is possible and `surface` is missing.
        """
        if surface is None and any(group.surface for group in self.plan.groups):
            raise ValueError("the plan has contact of solids: their surfaces are asked for")
        rows = ParticleRows(x, v, volume, ids, owner, theta, C, sh, surface)
        if self.plan.sources:
            rows = rows.select(ids < self.plan.initial_particle_count)
        maxima = self.ranks.max(self._insert([rows, *self._spawned(None)]))
        if self.sources is not None:
            maxima = self.sources.merge_bounds(maxima, self.time)
        self.rate = float(maxima[0])
        self.particle_maxima = ParticleMaxima.of(
            maxima[1:], self.rate, 1.0 / (self.rate or self.plan.rate)
        )
        if self.reactions is not None:
            self.reactions.set_mass_bound(self.groups)
        self.sort()
        self.moved = 0  # finding the first owners is no migration

    def _spawned(self, before: float | None) -> list[ParticleRows]:
        """Return what inlets spawn here after `before` [s] (None: at the start)."""
        return [] if self.sources is None else self.sources.spawn(before, self.time)

    def _insert(self, chunks: list[ParticleRows]) -> np.ndarray:
        """Insert particles and return particle_insertion.bounds, (4,). A sort must follow."""
        limits = np.zeros(4)
        for rows in chunks:
            added = insert(self.plan, self.lattice, self.groups, rows, self.sides)
            limits = np.maximum(limits, added)
            if self.flow_accounting is not None:
                self.flow_accounting.add(rows)
        return limits

    def sort(self) -> None:
        """Sort all particles, rebalance the ranks if that pays, and set the directory."""
        steps = self.step - self.sorted_at
        census, self.cut, departed = migration.sort_particles(
            self.groups, self.ranks, self.cut, steps, self.pace.measure_work(self.groups, steps)
        )
        self.moved += departed
        for mover in (self.movers, self.pins):
            if mover is not None:
                mover.stand(self.time)
        self.set_directory(census)
        self.sorted_at = self.step
        self.sorts += 1

    def set_directory(self, census: BlockDirectory) -> None:
        """Build the exchange tables for a directory, whose segments the groups already hold.

        The old tables are reused if they are the same, also near colliders and pinned parts.
        """
        unchanged = self.halo is not None and self.census.has_segments_of(census)
        unchanged &= self.movers is None and (self.pins is None or not self.pins.moving)
        self.census = census
        if not unchanged:
            self.tables = exchange_topology.build_topology(
                census, self.lattice, self.ranks.rank, self.needs, self.solids, self.pins
            )
            self.couplings.set_tables(self.tables, census)
            if self.movers is not None:
                self.movers.take(self.tables.at[self.tables.solid >= 0])
        self._set_segments(unchanged)
        if not unchanged:
            self.halo = self._exchange(self.halo, self.needs.step_layers)
            if self.plan.restores or self.plan.shift_interval:
                self.correction_halo = self._exchange(
                    self.correction_halo, self.needs.timeless_layers
                )

    def _set_segments(self, unchanged: bool) -> None:
        """Pass the segments to engine, loads and inlets; `unchanged` if the tables are the same."""
        self.engine.set_topology(self.tables, unchanged)
        if self.loads is not None:
            self.loads.find(self.groups)
        if self.sources is not None:
            self.sources.find(self.groups, self.time)

    def _exchange(self, before: HaloExchange | None, fields: Sequence[str]) -> HaloExchange:
        """Return the exchange of the fields by the present tables; the old one is closed."""
        if before is not None:
            before.link.close()
        return HaloExchange(self.ranks, self.tables, self.engine.words, fields)

    def poses(self) -> np.ndarray | None:
        """Return the poses of moving colliders, (m, 4, 4), start -> now [m]; None if none moves."""
        return None if self.movers is None else self.movers.poses(self.time)

    @property
    def load(self) -> np.ndarray:
        """Predicted work of each rank (ranks,) at the last sort, in steps of one fluid particle."""
        return self.census.load / SHARES

    def bound(self) -> float:
        """Return the largest stable time step [s], including impulsive loads within the step."""
        rate = max(self.rate, self.plan.rate)
        if self.loads is not None:
            speed = self.loads.impulsive_speed_ahead(self.groups, self.time, 1.0 / rate)
            rate += speed / (min(self.plan.cfl, MAX_CELLS_PER_STEP) * self.plan.dx)
        rate = rate if self.changes is None else self.changes.limit_rate(rate)
        for mover in (self.movers, self.pins):
            rate = rate if mover is None else mover.rate(self.time, rate)
        if self.driven is not None:  # nothing else bounds a step while all bodies are prescribed
            rate = self.driven.rate(self.time, max(rate, 1.0 / float(self.plan.times[-1])))
        return 1.0 / rate

    def advance(
        self, dt: float, requests: tuple[float, ...] = (), end: float | None = None
    ) -> np.ndarray:
        """Advance by one step of dt [s] from time n to n + 1.

        Args:
            dt: Time step [s].
            requests: Flags of this rank to be reduced over all ranks.
            end: Time n + 1 [s], by default the present time plus dt.

        Returns:
            Maxima of `requests` over all ranks.

        Raises:
            BlowUp: On all ranks, if a particle or a nodal sum failed in the step.
        """
        mark, engine = self.clock or (lambda name: None), self.engine
        end = self.time + dt if end is None else end
        if self.reactions is not None:
            self.reactions.begin(dt)
        for motion in self.motions:
            motion.begin_step(self.time, end, dt)
        overflows = self._correct_transfers(dt)
        pushed, gravity = self._apply_loads(end, dt), self.gravity
        if self.plan.gravity_ramp_time or self.plan.gravity_keys:
            gravity = self.plan.gravity_between(self.time, end)
        engine.begin(dt, gravity, self.particle_maxima.fastest(self.plan, dt, pushed))
        self._update_grid(self.halo)
        self.couplings.apply(engine, dt, gravity)
        report = engine.gather(self.step)  # v, C, x, state at n + 1
        if self.reactions is not None:
            self.reactions.add_step(engine.given(), self.movers, self.driven, self.pins)
        report.beyond.extend(overflows)
        mark("g2p")
        before, self.time = self.time, end
        self.step += 1
        report = self._update_open_boundaries(report)
        maxima = self._reduce_step(report, requests)
        mark("wait")
        if maxima[2] or (self.bodies is not None and self.bodies.departed):
            raise BlowUp(failure_message(self, report))
        if not maxima[0] and (self.flow_accounting is not None or self.driven is not None):
            maxima[MAXIMA_SLICE] = bounds_of_idle_group(self.plan)
            maxima[0] = 0.0 if self.flow_accounting is None else maxima[0]  # all is prescribed
        if self.sources is not None:
            maxima[MAXIMA_SLICE] = self.sources.merge_bounds(maxima[MAXIMA_SLICE], self.time)
        released = self.releases is not None and self.releases.due(before, self.time)
        if released:
            maxima[MAXIMA_SLICE] = np.maximum(maxima[MAXIMA_SLICE], self._release_bodies(before))
        self.rate = float(maxima[0])
        self.particle_maxima = ParticleMaxima.of(maxima[3:6], self.rate, dt)
        spawned = self.sources is not None and self.sources.due(before, self.time)
        if spawned:
            self._insert(self._spawned(before))
        moved = any(m and m.left_safe_range(self.time) for m in (self.movers, self.pins))
        moved |= self.sides is not None and self.sides.change(maxima[-1], self.time)
        if maxima[1] >= self.max_stray or moved or spawned or released:
            self.sort()
            mark("sort")
        return maxima[6 : 6 + len(requests)]

    def _apply_loads(self, end: float, dt: float) -> float:
        """Apply loads until `end` [s]; bound the speed added, also by motions [m/s]."""
        pushed = 0.0 if self.changes is None else self.changes.apply_forces(dt)
        if self.loads is not None:
            pushed += self.loads.apply(self.groups, self.time, end, dt)
        for motion in self.motions:
            pushed += self.plan.dx * motion.travels(self.time, end) / dt
        return pushed

    def _release_bodies(self, before: float) -> np.ndarray:
        """Release the bodies that are due after `before` [s]; return their bounds (4,)."""
        assert self.releases is not None
        self.correction_origin_step = self.step
        return self.releases.release(self.groups, before, self.time, self.ranks)

    def next_event_time(self, goal: float) -> float:
        """Return the time [s], at most `goal`, at which the time steps must land next."""
        return goal if self.releases is None else self.releases.next_landing(self.time, goal)

    def _update_open_boundaries(self, report: StepReport) -> StepReport:
        """Advect nozzle particles, and remove particles in outlets."""
        if self.sources is not None:
            report = self.sources.advect_nozzle(report, self.time)
        if self.sinks is not None and self.sinks.remove_particles(
            self.groups, self.step, self.time
        ):
            self._set_segments(unchanged=True)
        return report

    def _correct_transfers(self, dt: float) -> list[AccumulatorOverflow]:
        """Restore motion and shift particles before a step of dt [s] in which they are due."""
        steps = self.step - self.correction_origin_step
        shifts, restores = (
            bool(interval) and steps > 0 and steps % interval == 0
            for interval in (self.plan.shift_interval, self.plan.restores)
        )
        return self.restore(dt, shifts, restores) if shifts or restores else []

    def restore(
        self, dt: float, shifts: bool = False, restores: bool = True
    ) -> list[AccumulatorOverflow]:
        """Restore motion that the last transfers dissipated (transfer correction). Collective.

        A zero-length step passes the motion through the grid; its loss is that of each step.

        Args:
            dt: Length of the next step [s].
            shifts: Whether the particles of liquids are shifted.
            restores: Whether motion is restored.
        """
        shift = None
        if shifts:
            shift = shift_constants(self.plan, self.plan.shift_interval * dt, self.step)
        fastest = self.particle_maxima.fastest(self.plan, dt, 0.0)
        self.engine.begin(0.0, np.zeros(3), fastest, shift)
        self._update_grid(self.correction_halo)
        overflows = self.engine.restore(self.plan.restores if restores else 0)
        if self.sources is not None:
            self.sources.reset_nozzle(self.time)
        if self.clock:
            self.clock("g2p")
        return overflows

    def _update_grid(self, halo: HaloExchange | None) -> None:
        """Transfer x, v, C and the state at n to the grid, and find the nodal velocities at n + 1.

        They include the stress at n over dt, gravity, couplings, contact and walls.
        """
        engine, mark = self.engine, self.clock or (lambda name: None)
        assert halo is not None  # particles were inserted
        engine.fill(border=True)
        mark("p2g")
        halo.start(self.step, engine.pack)
        mark("halo")
        engine.fill(border=False)
        mark("p2g")
        halo.link.progress()
        engine.update(border=False)
        mark("grid")
        halo.link.wait()
        mark("wait")
        halo.finish(self.step, engine.add)
        mark("halo")
        engine.update(border=True)
        mark("grid")
        self.sent += halo.bytes_sent

    def _reduce_step(self, report: StepReport, requests: tuple[float, ...]) -> np.ndarray:
        """Reduce over all ranks: rate, farthest particle, failure flag, maxima, requests, sides."""
        if self.sides is not None:
            requests = *requests, self.sides.push_particles(self.step, self.time)
        buffer = self.reduction_buffer[: 6 + len(requests)]
        buffer[:3] = report.rate, report.far, bool(report.wrong or report.beyond)
        buffer[3:6], buffer[6:] = report.reach, requests
        return self.ranks.max(buffer)

    def object_of(self, ids: np.ndarray) -> np.ndarray:
        """Return the object of each particle; ids of one object are consecutive."""
        return np.searchsorted(np.array(self.plan.first_id), ids, side="right") - 1
