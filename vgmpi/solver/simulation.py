"""One step of the coupled multiphase material point method, and the state that it advances."""

from collections.abc import Callable, Sequence

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext, start_features
from vgmpi.features.particle_insertion import ParticleRows, insert_particles
from vgmpi.kernels.colliders.moving_colliders import place_colliders
from vgmpi.kernels.step_records import (
    UNKNOWN_MAXIMA,
    AccumulatorOverflow,
    ParticleBounds,
    StepMaxima,
    StepReport,
    StepSpan,
)
from vgmpi.kernels.transfer import g2p
from vgmpi.parallel import migration
from vgmpi.parallel.block_lattice import BlockLattice
from vgmpi.parallel.block_ownership import BlockDirectory
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.halo_exchange import GridExchange, HaloExchange
from vgmpi.parallel.load_balance import SHARES, RankPace
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.planning.feature_plan import first_reaction_rows
from vgmpi.planning.plan import Plan
from vgmpi.solver.engines.engine_protocol import Engine
from vgmpi.solver.engines.plan_tables import topology_requirements

from .failure_message import failure_message
from .run_options import engine_of
from .run_outcome import BlowUp


class Simulation:
    """Particles of all groups on this rank, and the clock. All methods are collective.

    time [s] and step are the state's; rate [1/s] is the least 1/dt that the state allows;
    particle_maxima bounds the sums of the next step. All four are part of a checkpoint.
    """

    def __init__(
        self, plan: Plan, ranks: SerialCommunicator, colliders: Sequence = (), threads: int = 1,
        engine: str = "cpu",
    ):  # fmt: skip
        """Set up the engine and the features of the plan, without particles."""
        self.plan, self.ranks, self.pace = plan, ranks, RankPace(ranks)
        self.lattice = BlockLattice(plan.cells, plan.dx)
        # true if a collider has its own friction, is free, or its reaction is requested
        per_collider = len(plan.contact.friction) > len(plan.phases) + 1 or plan.numbers_colliders
        moved = (feature.moved_bodies(list(colliders)) for feature in plan.features)
        free = next((bodies for bodies in moved if bodies is not None), None)
        placed = place_colliders(list(colliders), self.lattice, plan.real, per_collider, free)
        movers, self.collider_nodes = placed
        rows = first_reaction_rows(plan.features, len(colliders))
        motions = (feature.phase_motions(plan, rows[feature.name]) for feature in plan.features)
        prescribed = next((each for each in motions if each is not None), None)
        self.engine: Engine = engine_of(engine)(
            plan, self.lattice, self.collider_nodes, threads, prescribed
        )
        self.groups: list[ParticleGroup] = self.engine.groups
        self.features: dict[str, ActiveFeature] = {}
        context = StartContext(
            plan, self.lattice, ranks, self.groups, colliders, self.collider_nodes, movers,
            prescribed, threads, len(colliders), self.features, self.engine, self.insert,
            self.find_particles,
        )  # fmt: skip
        start_features(context, self.features)
        self.engine.features = self.features
        self.gravity = np.array(plan.gravity.vector)
        self.exchange = GridExchange(
            topology_requirements(plan), self.lattice, ranks, self.collider_nodes,
            self.engine.words,
            bool(
                plan.correction_interval
                or any(each.correction_interval for each in plan.features)
            ),
        )  # fmt: skip
        self.cut: np.ndarray | None = None
        self.time, self.step, self.rate, self.particle_maxima = 0.0, 0, 0.0, UNKNOWN_MAXIMA
        # what features then move must stay in its patch
        margin = sum(1.2 * feature.margin for feature in self.features.values())
        self.max_stray = g2p.MAX_STRAY_CELLS - margin
        self.sorts = self.sorted_at = 0
        self.moved = 0  # particles that left this rank for another
        self.clock: Callable[[str], None] | None = None  # marks the end of a stage

    # ---- particles -------------------------------------------------------------------------------

    def put(
        self, x: np.ndarray, v: np.ndarray, volume: np.ndarray, ids: np.ndarray,
        owner: np.ndarray, theta: np.ndarray | None = None, C: np.ndarray | None = None,
        sh: np.ndarray | None = None, surface: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Insert the initial particles, unstrained or compressed. Collective; call it once.

        Their order and their distribution over the ranks do not matter. Features may
        leave out particles that enter later.

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
        rows = [ParticleRows(x, v, volume, ids, owner, theta, C, sh, surface)]
        for feature in self.features.values():
            rows = feature.initial_particles(rows)
        bounds = ParticleBounds(*self.ranks.max(np.array(self.insert(rows))).tolist())
        for feature in self.features.values():
            bounds = feature.begin_run(bounds)
        self.rate = bounds.rate
        self.particle_maxima = bounds.maxima(1.0 / (self.rate or self.plan.time_step.min_rate))
        self.sort()
        self.moved = 0  # finding the first owners is no migration

    def insert(self, chunks: list[ParticleRows]) -> ParticleBounds:
        """Insert particles on this rank and return their bounds. A sort must follow."""
        bounds, features = ParticleBounds(), self.features.values()
        for rows in chunks:
            added = insert_particles(self.plan, self.lattice, self.groups, rows, features)
            bounds = bounds.merge(added)
            for feature in features:
                feature.count_inserted(rows)
        return bounds

    def sort(self) -> None:
        """Sort all particles, rebalance the ranks if that pays, and set the directory."""
        steps = self.step - self.sorted_at
        census, self.cut, departed = migration.sort_particles(
            self.groups, self.ranks, self.cut, steps, self.pace.measure_work(self.groups, steps)
        )
        self.moved += departed
        for feature in self.features.values():
            feature.place(self.time)
        self.set_directory(census)
        self.sorted_at = self.step
        self.sorts += 1

    def set_directory(self, census: BlockDirectory) -> None:
        """Build the exchange tables for a directory, whose segments the groups already hold."""
        self.find_particles(self.exchange.set_directory(census, self.features.values()))

    def find_particles(self, unchanged: bool = True) -> None:
        """Tell engine and features of the segments; `unchanged` if the tables are the same."""
        self.engine.set_topology(self.exchange.tables, unchanged)
        for feature in self.features.values():
            feature.find_particles(self.time)

    def object_of(self, ids: np.ndarray) -> np.ndarray:
        """Return the object of each particle; ids of one object are consecutive."""
        return np.searchsorted(np.array(self.plan.first_id), ids, side="right") - 1

    def poses(self) -> np.ndarray | None:
        """Return the poses of moving colliders, (m, 4, 4), start -> now [m]; None if none moves."""
        poses = (feature.collider_poses(self.time) for feature in self.features.values())
        return next((pose for pose in poses if pose is not None), None)

    @property
    def load(self) -> np.ndarray:
        """Predicted work of each rank (ranks,) at the last sort, in steps of one fluid particle."""
        return self.exchange.census.load / SHARES

    # ---- a step ----------------------------------------------------------------------------------

    def bound(self) -> float:
        """Return the largest stable time step [s], including impulsive loads within the step."""
        rate = max(self.rate, self.plan.time_step.min_rate)
        for feature in self.features.values():
            rate = feature.limit_rate(self.time, rate)
        return 1.0 / rate

    def next_event_time(self, goal: float) -> float:
        """Return the time [s], at most `goal`, at which the time steps must land next."""
        for feature in self.features.values():
            goal = feature.next_event(self.time, goal)
        return goal

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
        span = StepSpan(self.step + 1, self.time, self.time + dt if end is None else end, dt)
        mark, engine, features = self.clock or (lambda name: None), self.engine, self.features
        for feature in features.values():
            feature.begin_step(span)  # motions from n to n + 1
        overflows = self._correct_if_due(dt)
        speed = sum(feature.push_particles(span) for feature in features.values())
        gravity = self._gravity_in(span)
        engine.begin(dt, gravity, self.particle_maxima.fastest(self.plan, dt, speed))
        self._update_grid(
            self.exchange.halo, span
        )  # x, v, C, state at n -> nodal velocities at n + 1
        self._couple_nodes(span, gravity)
        report = engine.gather(self.step)  # v, C, x, state at n + 1
        report.overflows.extend(overflows)
        mark("g2p")
        self.time, self.step = span.end, span.number
        for feature in features.values():
            report = feature.end_step(span, report)
        maxima = self._reduce(span, report, requests)
        mark("wait")
        if maxima.has_failed or any(feature.failure() for feature in features.values()):
            raise BlowUp(failure_message(self, report))
        bounds = maxima.bounds
        for feature in features.values():
            bounds = feature.adjust_bounds(span, bounds)
        self.rate, self.particle_maxima = bounds.rate, bounds.maxima(dt)
        moved = [feature.needs_sort(span, maxima) for feature in features.values()]
        if any(moved) or maxima.stray >= self.max_stray:
            self.sort()
            mark("sort")
        return maxima.requests

    def _gravity_in(self, span: StepSpan) -> np.ndarray:
        """Return the mean gravity in a step, shape (3,) [m/s2]."""
        if self.plan.gravity.changes:
            return self.plan.gravity.mean_between(span.start, span.end)
        return self.gravity

    def _correct_if_due(self, dt: float) -> list[AccumulatorOverflow]:
        """Make a step of no time before a step of dt [s] in which one is due."""
        features = self.features.values()
        steps = self.step - max((each.correction_origin for each in features), default=0)
        with_features, corrects = (
            any(interval and steps > 0 and steps % interval == 0 for interval in intervals)
            for intervals in (
                [each.correction_interval for each in features],
                [self.plan.correction_interval],
            )
        )
        if not (with_features or corrects):
            return []
        return self.correct_transfers(dt, with_features, corrects)

    def correct_transfers(
        self, dt: float, with_features: bool = False, corrects: bool = True
    ) -> list[AccumulatorOverflow]:
        """Restore motion that the last transfers dissipated (transfer correction). Collective.

        A zero-length step passes the motion through the grid; its loss is that of each step.

        Args:
            dt: Length of the next step [s].
            with_features: Whether features take part.
            corrects: Whether motion is restored.
        """
        features = self.features.values()
        kinds = None
        if with_features:
            own = (feature.correction_kinds(dt, self.step) for feature in features)
            kinds = next((each for each in own if each is not None), None)
        fastest = self.particle_maxima.fastest(self.plan, dt, 0.0)
        self.engine.begin(0.0, np.zeros(3), fastest, kinds)
        self._update_grid(self.exchange.correction_halo)
        overflows = self.engine.correct_transfers(self.plan.correction_interval if corrects else 0)
        moves = any(feature.correction_interval for feature in features)
        for feature in features:
            feature.end_correction(self.time, moves)
        if self.clock:
            self.clock("g2p")
        return overflows

    def _update_grid(self, halo: HaloExchange | None, span: StepSpan | None = None) -> None:
        """Transfer x, v, C and the state at n to the grid, exchange sums, find nodal velocities.

        They include the stress at n over dt (without a pressure that features find), gravity,
        mixtures, contact and walls; `_couple_nodes` may change them.
        """
        engine, mark = self.engine, self.clock or (lambda name: None)
        assert halo is not None  # particles were inserted
        filters = [each for each in self.features.values() if span and each.filters_impulses]
        engine.fill(border=True)
        mark("p2g")
        halo.start(self.step, engine.pack)
        mark("halo")
        engine.fill(border=False)
        mark("p2g")
        halo.link.progress()
        if not filters:
            engine.update(border=False)
        mark("grid")
        halo.link.wait()
        mark("wait")
        halo.finish(self.step, engine.add)
        mark("halo")
        if span and filters:
            nodes = engine.begin_impulses()
            for feature in filters:
                feature.filter_stress(nodes, span)
            engine.update(border=False)
        engine.update(border=True)
        mark("grid")
        self.exchange.bytes_sent += halo.bytes_sent

    def _couple_nodes(self, span: StepSpan, gravity: np.ndarray) -> None:
        """Let features change the nodal velocities at n + 1."""
        coupling = [feature for feature in self.features.values() if feature.couples_nodes]
        if not coupling:
            return
        nodes = self.engine.begin_coupling()
        for feature in coupling:
            feature.couple_nodes(nodes, span, gravity)
        self.engine.end_coupling()
        for feature in coupling:
            feature.end_coupling(span)

    def _reduce(
        self, span: StepSpan, report: StepReport, requests: tuple[float, ...]
    ) -> StepMaxima:
        """Return the largest results of all ranks."""
        asking = {name: each for name, each in self.features.items() if each.has_request}
        own = [feature.request(span) for feature in asking.values()]
        has_failed = bool(report.failures or report.overflows)
        row = [report.rate, *report.bounds, report.stray, has_failed, *requests, *own]
        rate, speed, turn, stress, stray, failed, *others = self.ranks.max(np.array(row, float))
        count = len(requests)
        bounds = ParticleBounds(float(rate), float(speed), float(turn), float(stress))
        of_features = dict(zip(asking, others[count:], strict=True))
        return StepMaxima(bounds, stray, bool(failed), np.array(others[:count]), of_features)
