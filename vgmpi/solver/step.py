"""One step of the coupled multiphase point method, and the state it advances."""

import numpy as np

from ..couplings.base import CONTACT, MIXING
from ..domain import migrate, topology
from ..domain.balance import SHARES
from ..domain.blocks import Lattice
from ..domain.census import Census
from ..domain.halo import Halo
from ..domain.ranks import Alone
from ..domain.solids import Solids
from ..domain.state import Group
from ..engines.cpu import Cpu
from ..kernels import g2p, records
from ..materials.base import function
from ..planning.plan import Plan
from .loads import Loads

REASONS = {
    g2p.CRUSHED: "its volume ratio J left 0.1 .. 5 or is not a number",
    g2p.OUTSIDE: "it left the domain",
    g2p.TOO_FAST: "it would move more than a cell in one step",
    g2p.LOST: "its velocity or stress is not a number",
}


class BlowUp(RuntimeError):
    """The state can no longer be trusted. Names the object, the particle and the step."""


def _apart(plan: Plan) -> topology.Apart | None:
    """Where the stress's impulses are kept apart: for FLIP, and where phases share space."""
    rules = plan.rules
    if rules is None:
        return topology.Apart(True, None, None, None) if plan.flip else None
    same = rules.together[:, None] == rules.together[None, :]
    shares = same & (rules.together >= 0)[:, None] & ~np.eye(len(same), dtype=bool)
    drifts = (rules.diffusion > 0.0)[rules.mix] if rules.mixes else np.zeros(len(same), bool)
    asks = (rules.pair == CONTACT) & ~np.eye(len(same), dtype=bool)
    asks |= (rules.pair == MIXING) & drifts[:, None]
    return topology.Apart(False, shares, asks, rules.fluid)


class Simulation:
    """Particles of all groups on this rank, and the clock. Collective: all ranks call the same
    methods.

    time [s] and step are the state's; rate [1/s] is the least 1/dt the state allows; both are part
    of a checkpoint.
    """

    def __init__(
        self, plan: Plan, ranks: Alone, colliders: list = (), threads: int = 1, loads: list = ()
    ):
        self.plan = plan
        self.ranks = ranks
        self.lattice = Lattice(plan.cells, plan.dx)
        self.solids = Solids(list(colliders), self.lattice, plan.real) if colliders else None
        self.engine = Cpu(plan, self.solids, threads)
        self.groups = [Group(group, self.lattice, plan.real) for group in plan.groups]
        self.loads = Loads(loads, plan.real) if loads else None
        self.phase_of = np.array([group.phase for group in plan.groups])
        self.apart = _apart(plan)
        self.cut: np.ndarray | None = None
        self.halo: Halo | None = None
        self.time = 0.0
        self.step = 0
        self.rate = 0.0
        self.sorts = 0
        self.sorted_at = 0
        self.sent = 0  # bytes this rank gave its neighbours
        self.moved = 0  # particles that left this rank for another
        self.worst, self.said = np.zeros(4), np.zeros(8)
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
    ) -> None:
        """Take particles, unstrained or compressed, in any order, any share on any rank.
        Collective; once, at the start.

        x: positions [m], (n, 3); v: velocities [m/s], (n, 3); volume: rest volumes [m3], (n,); ids:
        (n,); thing: object of each, (n,); theta: ln J of fluids, (n,), or None for 0; C: gradients
        of v [1/s], (n, 9), or None for 0; sh: (n, K, 3) colours, asked for where these travel.
        """
        group_of = np.array(self.plan.group_of)[thing] if len(thing) else thing
        fastest = 0.0
        for g, group in enumerate(self.groups):
            here = group_of == g
            block, xi = self.lattice.place(x[here], self.plan.real)
            f = np.zeros((group.channels, int(here.sum())), self.plan.real)
            f[0:3] = v[here].T
            if C is not None:
                f[records.AFFINE : records.VOLUME] = C[here].T
            f[records.VOLUME] = volume[here]
            f[records.STATE :] = np.array(group.plan.carried)[:, None]
            count = group.plan.coefficients
            if count and sh is not None:
                shown = sh[here, :count] - self.plan.colours.least[group.plan.phase, :count]
                f[group.plan.colour :] = shown.reshape(len(shown), 3 * count).T
            states = [group.plan.rest]
            if theta is not None and self.plan.phases[group.plan.phase].family == "fluid":
                f[records.STATE] = theta[here]
                # the fastest wave is at an end of the range, which the ranks agree on bit by bit
                states += [(end, *group.plan.rest[1:]) for end in _ends(theta[here])]
            if here.any():
                law = group.plan.law
                waves = [function(law, "wave_speed2")(law, state) for state in states]
                wave = np.sqrt(group.plan.bound(max(waves)))
                speed = np.sqrt((v[here] ** 2).sum(1)).max()
                fastest = max(fastest, float(wave + speed), float(speed) * self.plan.cfl / 0.3)
            migrate.arrive(group, block, xi, f, ids[here])
        rate = fastest / (self.plan.cfl * self.plan.dx)
        if C is not None and len(C):
            rate = max(rate, float(np.abs(C[:, 0] + C[:, 4] + C[:, 8]).max()) / 0.1)
        self.rate = float(self.ranks.max(np.array([rate]))[0])
        self.sort()
        self.moved = 0  # finding the first owners is no migration

    def sort(self) -> None:
        """Re-sort all particles, cut the curve anew if the load asks for it, and lay out the
        tables.
        """
        steps = self.step - self.sorted_at
        census, self.cut, left = migrate.sort(self.groups, self.ranks, self.cut, steps)
        self.moved += left
        self.adopt(census)
        self.sorted_at = self.step
        self.sorts += 1

    def adopt(self, census: Census) -> None:
        """Lay out tables and buffers for the census, whose segments the groups already hold."""
        self.census = census
        tables = topology.build(
            census, self.lattice, self.ranks.rank, self.phase_of, self.plan.contact, self.solids,
            self.apart,
        )  # fmt: skip
        self.engine.adopt(self.groups, tables, census.group)
        if self.loads is not None:
            self.loads.find(self.groups)
        if self.halo is not None:
            self.halo.link.close()
        self.halo = Halo(self.ranks, tables, self.engine.slots, self.plan.real)

    @property
    def load(self) -> np.ndarray:
        """Predicted work of each rank as of the last sort, in steps of one fluid particle:
        (ranks,)."""
        return self.census.load / SHARES

    def bound(self) -> float:
        """Largest stable time step [s] of the present state."""
        return 1.0 / max(self.rate, self.plan.rate)

    def advance(self, dt: float, requests: tuple[float, ...] = ()) -> np.ndarray:
        """One step of dt [s]: time n to n + 1. Returns the maxima over all ranks of `requests`.

        Raises BlowUp, on all ranks, after the step in which a particle went wrong.
        """
        mark = self.clock or (lambda name: None)
        engine, sent = self.engine, (self.step, *self.engine.layers)
        if self.loads is not None:
            self.loads.push(self.groups, self.time, dt)
        if self.plan.gravity_ramp:
            share = self.plan.gravity_share(self.time, self.time + dt)
            np.multiply(self.plan.gravity, share, out=engine.gravity)
        # x, v, C, state at n -> mass and momentum (with the stress at n over dt)
        engine.p2g(dt, border=True)
        mark("p2g")
        self.halo.start(*sent)
        mark("halo")
        engine.p2g(dt, border=False)
        mark("p2g")
        self.halo.link.nudge()
        # node velocities at n + 1: gravity, contact, walls
        engine.update(dt, border=False)
        mark("grid")
        self.halo.link.wait()
        mark("wait")
        self.halo.finish(*sent)
        mark("halo")
        engine.update(dt, border=True)
        mark("grid")
        reports = engine.g2p(dt, self.step)  # v, C, x, state at n + 1
        mark("g2p")
        self.sent += self.halo.bytes_sent
        self.time += dt
        self.step += 1
        found = self._agreed(reports, requests)
        mark("wait")
        if found[2]:
            raise BlowUp(self._blame(reports))
        self.rate = float(found[0])
        if found[1] >= g2p.REACH:
            self.sort()
            mark("sort")
        return found[3:]

    def _agreed(self, reports: np.ndarray, requests: tuple[float, ...]) -> np.ndarray:
        """The step's one reduction: rate, farthest particle, whether one went wrong, requests."""
        said = self.said[: 3 + len(requests)]
        reports.max(axis=(0, 1), out=self.worst)
        said[:2] = self.worst[:2]
        said[2] = self.worst[2] > 0
        said[3:] = requests
        return self.ranks.max(said)

    def object_of(self, ids: np.ndarray) -> np.ndarray:
        """Object of each particle: ids of one object follow each other."""
        return np.searchsorted(np.array(self.plan.first_id), ids, side="right") - 1

    def _blame(self, reports: np.ndarray) -> str:
        """Name the bad particle of lowest id, the same on every rank."""
        rows = [
            (int(report[2]) - 1, int(report[3]))
            for report in reports.reshape(-1, 4)
            if report[2] > 0
        ]
        rows = self.ranks.all_rows(np.array(rows, np.int64).reshape(-1, 2))
        worst, reason = rows[np.argmin(rows[:, 0])]
        # an empty object begins where the next one does: take the one that has particles
        thing = int(self.object_of(np.array([worst]))[0])
        where = f"particle {worst}, step {self.step}, time {self.time:.6g} s"
        return f"object {{{thing}}}, {where}: {REASONS[int(reason)]}"


def _ends(values: np.ndarray) -> list[float]:
    """Smallest and largest of (n,) values; nothing of none."""
    return [float(values.min()), float(values.max())] if len(values) else []
