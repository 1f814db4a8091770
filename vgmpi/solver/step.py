"""One step of the coupled multiphase point method, and the state it advances."""

from collections.abc import Sequence

import numpy as np

from ..device.limits import FARTHEST, LEAST_J, MOST_J
from ..domain import migrate, topology
from ..domain.balance import SHARES
from ..domain.blocks import Lattice
from ..domain.census import Census
from ..domain.driven import Driven
from ..domain.halo import Halo
from ..domain.movers import Movers
from ..domain.ranks import Alone
from ..domain.solids import Solids
from ..domain.state import Group
from ..engines.base import UNKNOWN, Beyond, Engine, Reach, Report
from ..kernels import g2p
from ..planning.plan import Plan
from .driven import Releases
from .engines import engine_of
from .enter import Rows, enter, idle
from .given import Given
from .inflow import Sources
from .needs import needs
from .pushes import Pushes
from .sinks import Sinks
from .tally import Tally

REASONS = {
    g2p.CRUSHED: f"its volume ratio J left {LEAST_J:g} .. {MOST_J:g} or is not a number",
    g2p.OUTSIDE: "it left the domain",
    g2p.TOO_FAST: "it would move more than a cell in one step",
    g2p.LOST: "its velocity or stress is not a number",
}
BOUNDS = [0, 3, 4, 5]  # of a step's maxima over the ranks, those of enter.bounds
SUMMED = {
    "momentum": "mass or momentum",
    "offsets": "volume",
    "impulses": "impulse",
    "shear": "velocity's gradient",
    "colour": "colour",
}


class BlowUp(RuntimeError):
    """The state can no longer be trusted. Names the object, the particle and the step."""


class Simulation:
    """Particles of all groups on this rank, and the clock. Collective: all ranks call the same
    methods.

    time [s] and step are the state's; rate [1/s] is the least 1/dt the state allows; reach bounds
    the sums of the next step; all are part of a checkpoint.
    """

    def __init__(
        self,
        plan: Plan,
        ranks: Alone,
        colliders: Sequence = (),
        threads: int = 1,
        loads: Sequence = (),
        engine: str = "cpu",
    ):
        self.plan = plan
        self.ranks = ranks
        self.lattice = Lattice(plan.cells, plan.dx)
        # a collider's friction is its own, or what it gives is asked for
        asked = len(plan.friction) > len(plan.phases) + 1 or plan.feels
        self.movers: Movers | None = None
        if any(collider.course is not None for collider in colliders):
            self.movers = Movers(list(colliders), self.lattice, plan.real, asked)
        self.solids: Movers | Solids | None = self.movers
        if colliders and self.movers is None:
            self.solids = Solids(list(colliders), self.lattice, plan.real, asked)
        self.driven = Driven(plan, len(colliders)) if plan.driven else None
        self.engine: Engine = engine_of(engine)(
            plan, self.lattice, self.solids, threads, self.driven
        )
        self.groups: list[Group] = self.engine.groups
        self.given = Given(plan, colliders, ranks) if plan.feels else None
        if self.given is not None:
            self.engine.feel(len(self.given.totals), self.given.quanta, ranks.rank)
        self.loads = Pushes(list(loads), plan, ranks) if loads else None
        self.tally = Tally(plan) if plan.flows else None
        self.sources = Sources(plan, ranks) if plan.sources else None
        self.sinks = Sinks(plan, self.tally) if self.tally is not None and plan.sinks else None
        lets_go = bool(plan.driven) or any(time is not None for time in plan.opens)
        self.releases = Releases(plan, self.tally, self.engine) if lets_go else None
        self.since = 0  # step at which something was let go: from then on restoring counts
        self.gravity = np.array(plan.gravity)
        self.needs = needs(plan)
        self.tables: topology.Topology
        self.census: Census
        self.cut: np.ndarray | None = None
        self.halo: Halo | None = None
        self.motion: Halo | None = None  # of a step of no time
        self.time = 0.0
        self.step = 0
        self.rate = 0.0
        self.reach = UNKNOWN
        self.sorts = 0
        self.sorted_at = 0
        self.sent = 0  # bytes this rank gave its neighbours
        self.moved = 0  # particles that left this rank for another
        self.said = np.zeros(12)
        self.clock = None  # a callable(name) that marks the end of a stage, or None

    def put(
        self,
        x: np.ndarray,
        v: np.ndarray,
        volume: np.ndarray,
        ids: np.ndarray,
        thing: np.ndarray,
        theta: np.ndarray | None = None,
        C: np.ndarray | None = None,
        sh: np.ndarray | None = None,
        surface: np.ndarray | None = None,
    ) -> None:
        """Take particles, unstrained or compressed, in any order, any share on any rank.
        Collective; once, at the start. Particles of sources are left out: they come when it is
        their time.

        x: positions [m], (n, 3); v: velocities [m/s], (n, 3); volume: rest volumes [m3], (n,); ids:
        (n,); thing: object of each, (n,); theta: ln J of fluids, (n,), or None for 0; C: gradients
        of v [1/s], (n, 9), or None for 0; sh: (n, K, 3) colours, asked for where these travel;
        surface: (n, 10) of solids, see planning/channels.py, asked for where something may touch.
        Raises ValueError where it is not given.
        """
        if surface is None and any(group.surface for group in self.plan.groups):
            raise ValueError("the plan has contact of solids: their surfaces are asked for")
        rows = Rows(x, v, volume, ids, thing, theta, C, sh, surface)
        if self.plan.sources:
            rows = rows.only(ids < self.plan.starts_with)
        found = self.ranks.max(self._enter([rows, *self._born(None)]))
        if self.sources is not None:
            found = self.sources.bound(found, self.time)
        self.rate = float(found[0])
        self.reach = Reach.of(found[1:], self.rate, 1.0 / self.rate)
        if self.given is not None:
            self.given.weigh(self.groups)
        self.sort()
        self.moved = 0  # finding the first owners is no migration

    def _born(self, before: float | None) -> list[Rows]:
        """What sources bring on this rank after `before` [s], None: at the start, up to now."""
        return [] if self.sources is None else self.sources.bring(before, self.time)

    def _enter(self, parts: list[Rows]) -> np.ndarray:
        """Give particles to the groups of this rank; returns what bounds their steps and sums,
        (4,). A sort must follow."""
        least = np.zeros(4)
        for rows in parts:
            least = np.maximum(least, enter(self.plan, self.lattice, self.groups, rows))
            if self.tally is not None:
                self.tally.come(rows)
        return least

    def sort(self) -> None:
        """Re-sort all particles, cut the curve anew if the load asks for it, and lay out the
        tables.
        """
        steps = self.step - self.sorted_at
        census, self.cut, left = migrate.sort(self.groups, self.ranks, self.cut, steps)
        self.moved += left
        if self.movers is not None:
            self.movers.stand(self.time)
        self.adopt(census)
        self.sorted_at = self.step
        self.sorts += 1

    def adopt(self, census: Census) -> None:
        """Lay out tables and buffers for the census, whose segments the groups already hold. Where
        no segment came or went and none changed its owner, those of before serve again."""
        kept = self.halo is not None and _same_blocks(self.census, census)
        kept &= self.movers is None  # which are near other blocks now
        self.census = census
        if not kept:
            self.tables = topology.build(
                census, self.lattice, self.ranks.rank, self.needs, self.solids
            )
            if self.movers is not None:
                self.movers.take(self.tables.at[self.tables.solid >= 0])
        self._hand_over(kept)
        if not kept:
            self.halo = self._exchange(self.halo)
            if self.plan.restores:
                self.motion = self._exchange(self.motion, ["momentum"])

    def _hand_over(self, kept: bool) -> None:
        """Tell the engine, loads and sources of the segments in force. kept: the tables are those
        that the engine has."""
        self.engine.adopt(self.tables, kept)
        if self.loads is not None:
            self.loads.find(self.groups)
        if self.sources is not None:
            self.sources.find(self.groups, self.time)

    def _exchange(self, before: Halo | None, layers: Sequence[str] = ()) -> Halo:
        """The exchange of layers by the tables in force, in the place of the one before."""
        if before is not None:
            before.link.close()
        return Halo(self.ranks, self.tables, self.engine.words, layers)

    def poses(self) -> np.ndarray | None:
        """Where moving colliders are now: (m, 4, 4), place at the start -> place [m]; None where
        none moves."""
        return None if self.movers is None else self.movers.poses(self.time)

    @property
    def load(self) -> np.ndarray:
        """Predicted work of each rank as of the last sort, in steps of one fluid particle:
        (ranks,)."""
        return self.census.load / SHARES

    def bound(self) -> float:
        """Largest stable time step [s] of the present state, and of what loads give in it at
        once."""
        rate = max(self.rate, self.plan.rate)
        if self.loads is not None:
            speed = self.loads.soon(self.groups, self.time, 1.0 / rate)
            rate += speed / (min(self.plan.cfl, FARTHEST) * self.plan.dx)
        if self.movers is not None:
            rate = self.movers.rate(self.time, rate)
        if self.driven is not None:  # while all is held, nothing bounds a step
            rate = self.driven.rate(self.time, max(rate, 1.0 / float(self.plan.times[-1])))
        return 1.0 / rate

    def advance(
        self, dt: float, requests: tuple[float, ...] = (), end: float | None = None
    ) -> np.ndarray:
        """One step of dt [s]: time n to n + 1, which is `end` [s] where that is given. Returns the
        maxima over all ranks of `requests`.

        Raises BlowUp, on all ranks, after the step in which a particle went wrong.
        """
        mark = self.clock or (lambda name: None)
        engine = self.engine
        every, beyond, steps = self.plan.restores, [], self.step - self.since
        if self.given is not None:
            self.given.begin(dt)
        if every and steps and steps % every == 0:
            beyond = self.restore(dt)
        end = self.time + dt if end is None else end
        pushed, gravity = self._pushed(end, dt), self.gravity
        if self.plan.gravity_ramp or self.plan.gravity_keys:
            gravity = self.plan.gravity_between(self.time, end)
        engine.begin(dt, gravity, self.reach.fastest(self.plan, dt, pushed))
        self._to_nodes(self.halo)
        report = engine.gather(self.step)  # v, C, x, state at n + 1
        if self.given is not None:
            self.given.take(engine.given(), self.movers, self.driven)
        report.beyond.extend(beyond)
        mark("g2p")
        before, self.time = self.time, end
        self.step += 1
        report = self._flow(report)
        found = self._agreed(report, requests)
        mark("wait")
        if found[2]:
            raise BlowUp(self._blame(report))
        if not found[0] and (self.tally is not None or self.driven is not None):
            found[BOUNDS] = idle(self.plan)
            found[0] = 0.0 if self.tally is None else found[0]  # all of it is driven
        if self.sources is not None:
            found[BOUNDS] = self.sources.bound(found[BOUNDS], self.time)
        freed = self.releases is not None and self.releases.due(before, self.time)
        if freed:
            found[BOUNDS] = np.maximum(found[BOUNDS], self._let_go(before))
        self.rate = float(found[0])
        self.reach = Reach.of(found[3:6], self.rate, dt)
        born = self.sources is not None and self.sources.due(before, self.time)
        if born:
            self._enter(self._born(before))
        strayed = self.movers is not None and self.movers.strayed(self.time)
        if found[1] >= g2p.REACH or strayed or born or freed:
            self.sort()
            mark("sort")
        return found[6:]

    def _pushed(self, end: float, dt: float) -> float:
        """Let loads and what moves act until `end`, dt [s] from now. Returns by how much they
        change velocities [m/s], at the most."""
        pushed = 0.0
        if self.loads is not None:
            pushed = self.loads.push(self.groups, self.time, end, dt)
        for moved in (self.movers, self.driven):
            if moved is not None:
                moved.go(self.time, end, dt)
                pushed += self.plan.dx * moved.travels(self.time, end) / dt
        return pushed

    def _let_go(self, before: float) -> np.ndarray:
        """Let go what is due after `before` [s]. Returns what bounds the steps of it, (4,)."""
        assert self.releases is not None
        self.since = self.step
        return self.releases.let_go(self.groups, before, self.time, self.ranks)

    def ahead(self, goal: float) -> float:
        """The time [s] up to `goal` at which steps must land next."""
        return goal if self.releases is None else self.releases.ahead(self.time, goal)

    def _flow(self, report: Report) -> Report:
        """Carry what is in nozzles to where it is now, and take away what is in sinks."""
        if self.sources is not None:
            report = self.sources.carry(report, self.time)
        if self.sinks is not None and self.sinks.take(self.groups, self.step, self.time):
            self._hand_over(kept=True)
        return report

    def restore(self, dt: float) -> list[Beyond]:
        """Give the particles what transfers have taken from their motion in the last steps. A step
        of no time passes it through the grid: what that takes, each of them took. Collective. dt:
        of the next step [s]."""
        self.engine.begin(0.0, np.zeros(3), self.reach.fastest(self.plan, dt, 0.0))
        self._to_nodes(self.motion)
        beyond = self.engine.restore(self.plan.restores)
        if self.sources is not None:
            self.sources.hold()
        if self.clock:
            self.clock("g2p")
        return beyond

    def _to_nodes(self, halo: Halo | None) -> None:
        """x, v, C, state at n -> mass and momentum (with the stress at n over dt) -> velocities at
        the nodes at n + 1: gravity, couplings, contact, walls."""
        engine, mark = self.engine, self.clock or (lambda name: None)
        assert halo is not None  # particles were put
        engine.fill(border=True)
        mark("p2g")
        halo.start(self.step, engine.pack)
        mark("halo")
        engine.fill(border=False)
        mark("p2g")
        halo.link.nudge()
        engine.update(border=False)
        mark("grid")
        halo.link.wait()
        mark("wait")
        halo.finish(self.step, engine.add)
        mark("halo")
        engine.update(border=True)
        mark("grid")
        self.sent += halo.bytes_sent

    def _agreed(self, report: Report, requests: tuple[float, ...]) -> np.ndarray:
        """The step's one reduction: rate, farthest particle, whether something went wrong, reach,
        requests."""
        said = self.said[: 6 + len(requests)]
        said[:3] = report.rate, report.far, bool(report.wrong or report.beyond)
        said[3:6], said[6:] = report.reach, requests
        return self.ranks.max(said)

    def object_of(self, ids: np.ndarray) -> np.ndarray:
        """Object of each particle: ids of one object follow each other."""
        return np.searchsorted(np.array(self.plan.first_id), ids, side="right") - 1

    def _blame(self, report: Report) -> str:
        """Name the bad particle of lowest id, or the first node block of which a sum left its
        range: the same on every rank."""
        rows = self.ranks.all_rows(np.array(report.wrong, np.int64).reshape(-1, 2))
        when = f"step {self.step}, time {self.time:.6g} s"
        if len(rows):
            worst, reason = rows[np.argmin(rows[:, 0])]
            # an empty object begins where the next one does: take the one that has particles
            thing = int(self.object_of(np.array([worst]))[0])
            return f"object {{{thing}}}, particle {worst}, {when}: {REASONS[int(reason)]}"
        layers = self.needs.layers
        mine = [(*one.block, one.phase, layers.index(one.layer)) for one in report.beyond]
        rows = self.ranks.all_rows(np.array(mine, np.int64).reshape(-1, 5))
        *block, phase, layer = min(map(tuple, rows.tolist()))
        near = ", ".join(f"{(4 * b + 0.5) * self.plan.dx:.4g}" for b in block)
        what = SUMMED[layers[layer].split()[0]]
        return (
            f"phase '{self.plan.phases[phase].name}', near ({near}) m, {when}: the {what} at a node"
            " is beyond what a sum can hold"
        )


def _same_blocks(before: Census, after: Census) -> bool:
    """Whether two censuses have the same segments with the same owners."""
    return all(
        np.array_equal(getattr(before, name), getattr(after, name))
        for name in ("code", "group", "owner")
    )
