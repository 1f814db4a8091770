"""The method in plain numpy, as docs/theory.md tells it: slow, for tests and for reading.

One dense array per phase over all nodes of the domain, all particles of a group at once, double
precision, one rank and one thread. Of the rest of the program it takes the particles (domain.state)
and which of them keep their stress's impulses apart (the tables); no patches, sums without order or
compiled code. Sources: APIC (Jiang 2015), forces (Hu 2018), FLIP (Zhu & Bridson 2005).
"""

from typing import Any

import numpy as np

from ...device.limits import FARTHEST, LEAST_J, MOST_J, ROUNDING, STRETCH
from ...domain.blocks import EDGE, Lattice
from ...domain.driven import Driven
from ...domain.halo import Part
from ...domain.movers import Movers
from ...domain.solids import Solids
from ...domain.state import Group
from ...domain.topology import Topology
from ...kernels.beside import RELAX
from ...kernels.couple import LEAST_PORES
from ...kernels.g2p import CRUSHED, FASTEST_WAVE, LOST, OUTSIDE, TOO_FAST
from ...kernels.layers.offsets import DEEPEST
from ...materials.base import function
from ...planning.channels import BEND
from ...planning.plan import Plan
from ..base import DITHER, Beyond, Report
from .contact import Contact
from .dense import Dense, Stencil
from .driven import carry, prescribe
from .given import Given, Teller
from .movers import place
from .sharing import Sharing
from .volume import held


class Numpy:
    """See engines/base.py."""

    words = 1

    def __init__(
        self, plan: Plan, lattice: Lattice, solids: Solids | Movers | None, threads: int = 1,
        driven: Driven | None = None,
    ):  # fmt: skip
        self.driven = driven
        self.plan, self.dense = plan, Dense(plan)
        self.groups = [Group(group, lattice, plan.real) for group in plan.groups]
        self.contact = Contact(plan, self.dense)
        if driven is not None:
            self.contact.ways = driven.ways
        self.movers = solids if isinstance(solids, Movers) else None
        if isinstance(solids, Solids):
            self.contact.meet(*solids.surface(self.dense.points()))
        self.sharing = None if plan.rules is None else Sharing(plan.rules, self.dense)
        self.tells: Given | None = None
        self.apart = any(group.apart for group in plan.groups)

    def open(self, wall: int) -> None:
        axis, side = divmod(wall, 2)
        kind, _ = self.dense.walls[wall]
        self.dense.walls = tuple(
            ("open", 0.0) if k == wall else one for k, one in enumerate(self.dense.walls)
        )
        if kind != "open":
            self.contact.open(axis, side)

    def feel(self, rows: int, quanta: np.ndarray, rank: int) -> None:
        self.tells = self.contact.given = Given(self.plan, self.dense, rows, quanta)

    def given(self) -> np.ndarray:
        assert self.tells is not None
        return self.tells.taken()

    def _tell(self, p: int, share: float, mass: np.ndarray | None = None) -> Teller | None:
        """Told what walls do to a phase, None where nobody asks."""
        driven = self.plan.phases[p].driven  # which goes where it is sent
        return None if self.tells is None or driven else Teller(self.tells, p, share, mass)

    def adopt(self, tables: Topology, kept: bool = False) -> None:
        if tables.shared:
            raise RuntimeError("the numpy engine runs on one rank")
        split = tables.takes.get("impulses", np.zeros(len(tables.code), bool))
        self.split = [  # of each particle
            np.repeat(split[tables.group == g], group.count) for g, group in enumerate(self.groups)
        ]

    def begin(self, dt: float, gravity: np.ndarray, speed: float) -> None:
        self.dt, self.gravity, self.mirrors, self.kept = dt, gravity, 1.0, 0.0
        if self.tells is not None:
            self.mirrors, self.kept = self.tells.shares(dt)

    def pack(self, part: Part) -> None:
        raise RuntimeError("the numpy engine runs on one rank")

    add = pack

    # ---- particles to nodes ----------------------------------------------------------------------

    def fill(self, border: bool) -> None:
        """Sums over the particles of each phase: mass, momentum, impulses that are kept apart,
        volumes, offsets, colours."""
        if border:
            return
        # in a step of no time stress gives no impulse: what is summed for others nobody reads
        n, shape = len(self.plan.phases), self.dense.shape
        self.mass, self.volume, self.counted = (np.zeros((n, *shape, 1)) for _ in range(3))
        self.momentum, self.forces, self.offset, self.shear = (
            np.zeros((n, *shape, 3)) for _ in range(4)
        )
        hues = max(group.coefficients for group in self.plan.groups)
        self.hues = np.zeros((hues, n, *shape, 4))
        self.stencils = [self._stencil(group) for group in self.groups]
        for g, group in enumerate(self.groups):
            self._contribute(group, self.stencils[g], self.split[g])
        for p in range(n):
            self.dense.fold(self.momentum[p], self.mass[p], tell=self._tell(p, self.mirrors))
            self.dense.fold(self.forces[p], None, tell=self._tell(p, 1.0))
            self.dense.fold(None, self.counted[p])
            self.dense.fold(self.shear[p], None)
            self.dense.fold(self.offset[p], self.volume[p], kind="slip")

    def _stencil(self, group: Group) -> Stencil:
        at = group.index()
        xi = group.xi[:, at].astype(np.int64)
        block = np.repeat(group.block, group.count, axis=0)
        cell = xi >> group.bits
        inside = np.ldexp((xi - (cell << group.bits)).astype(np.float64), -group.bits)
        return Stencil(EDGE * block + 1 + cell.T, inside.T, self.plan.dx)

    def _contribute(self, group: Group, stencil: Stencil, split: np.ndarray) -> None:
        plan, dense, p = group.plan, self.dense, group.plan.phase
        v, C, vol0 = (self._get(group, name) for name in ("v", "C", "vol0"))
        state, law = self._state(group), self._law(group)
        m = plan.density * vol0[:, 0]
        J = np.broadcast_to(function(law, "volume_ratio")(law, state), m.shape)
        affine = m[:, None, None] * C.reshape(-1, 3, 3) if self.plan.affine else None
        dense.sum(self.mass[p], stencil, m[:, None])
        dense.sum(self.momentum[p], stencil, m[:, None] * v, affine)
        if plan.driven:  # no stress moves it
            split = np.zeros(len(m), bool)
        tau = self.dt * vol0[:, :, None] * self._stress(group, law, state, C) * (not plan.driven)
        if plan.porous:
            tau = np.where(split[:, None, None], tau / self._get(group, "share")[:, :, None], tau)
        apart = split[:, None, None]
        dense.sum_forces(self.momentum[p], stencil, np.where(apart, 0.0, tau))
        if self.apart:
            dense.sum_forces(self.forces[p], stencil, np.where(apart, tau, 0.0))
            dense.sum(self.counted[p], stencil, np.where(split, J * vol0[:, 0], 0.0)[:, None])
        if plan.surface:
            normal, distance, curve, sure = self._surface(group)
            sure = (m * sure)[:, None]
            dense.sum(self.offset[p], stencil, sure * normal, sure[:, None] * curve)
            there = m[:, None] * distance[:, None]
            dense.sum(self.volume[p], stencil, there, m[:, None, None] * normal[:, None])
            along = np.einsum("nab,nb->na", C.reshape(-1, 3, 3), normal)
            dense.sum(self.shear[p], stencil, self.plan.dx * m[:, None] * along)
        else:
            V = plan.share * vol0 * (J[:, None] if plan.apart else 1.0)
            dense.sum(self.volume[p], stencil, V)
            # the particle as seen from the node
            still = np.zeros((len(m), 3))
            dense.sum(self.offset[p], stencil, still, -V[:, :, None] * np.eye(3))
        for k in range(plan.coefficients):
            colour = self._get(group, "colour")[:, 3 * k : 3 * k + 3]
            rows = (J * vol0[:, 0])[:, None] * np.column_stack([colour, np.ones(len(m))])
            dense.sum(self.hues[k, p], stencil, rows)

    def _surface(self, group: Group) -> tuple[np.ndarray, ...]:
        """Of the body's surface as it is now: normal (n, 3), signed distance (n,) [m], the normal's
        gradient (n, 3, 3) [1/m], and how sure it is (n,)."""
        rest = self._get(group, "surface")
        sure = np.linalg.norm(rest[:, :3], axis=1)
        bend = rest[:, BEND].reshape(-1, 3, 3)
        F = np.eye(3) + self._get(group, "F" if group.plan.followed else "H").reshape(-1, 3, 3)
        back = np.linalg.inv(F)
        slope = np.einsum("nba,nb->na", back, rest[:, :3])  # F^-T n0
        size = np.linalg.norm(slope, axis=1)
        some, deep = size > 0, DEEPEST * self.plan.dx
        normal = np.where(some[:, None], slope / np.where(some, size, 1.0)[:, None], 0.0)
        shrinks = np.where(some, sure / np.where(some, size, 1.0), 0.0)  # 1 / |F^-T n0|
        curve = np.einsum("nba,nbc,ncd->nad", back, bend, back)  # F^-T K0 F^-1
        distance = np.clip(shrinks * rest[:, 3], -deep, deep)
        return normal, distance, shrinks[:, None, None] * curve, sure

    # ---- nodes -----------------------------------------------------------------------------------

    def update(self, border: bool) -> None:
        """Velocities at the nodes: gravity, couplings, contact, walls; mean colours."""
        if border:
            return
        plan, dense = self.plan, self.dense
        mass, volume, counted = (a[..., 0] for a in (self.mass, self.volume, self.counted))
        least = np.array([ROUNDING * phase.least for phase in plan.phases])[:, None, None, None]
        mass = np.where(mass > least, mass, 0.0)
        some = mass[..., None] > 0
        still = np.where(some, self.momentum / np.where(some, mass[..., None], 1.0), 0.0)
        if not self.dt:
            self.v = self._as_one(still, mass)
            for p, phase in enumerate(plan.phases):
                dense.mirror(self.v[p], phase.surface, self._tell(p, self.mirrors))
            return
        v = np.where(some, still + self.dt * self.gravity, 0.0)
        if self.movers is not None:
            points = self.dense.points()
            self.contact.meet(*place(self.movers.table, points, self.dt, plan.dx))
        self.contact.along_walls(self.offset)
        if plan.keeps is not None:  # all that does not share its pressure with others
            by_itself = np.ones(len(v), bool)
            if plan.rules is not None:
                by_itself = (plan.rules.together < 0) | ~np.asarray(plan.rules.fluid, bool)
            own = np.where(some, self.forces / np.where(some, mass[..., None], 1.0), 0.0)
            v[by_itself] += own[by_itself]
            self.forces[by_itself] = 0.0
        if self.sharing is not None:
            V = self.sharing.volumes(mass, counted)
            self.drift = self.sharing.act(v, mass, self.forces, V, self.offset, self.dt)
        heavy = mass.copy()
        if self.driven is not None:
            prescribe(v, heavy, self.driven.ways, dense.points(), plan.dx)
        slope = np.where(some, self.shear / np.where(some, mass[..., None], 1.0), 0.0)
        self.touching = self.contact.act(v, mass, heavy, self.offset, volume, slope, self.dt)
        for p, phase in enumerate(plan.phases):
            dense.constrain(v[p], phase.surface, self._tell(p, 1.0, mass[p]))
        if self.sharing is not None:
            self.flux, self.share, self.full = self.sharing.flux(v, mass, V)
            v = v - self.drift
        if plan.keeps is not None:
            self.change = v - still
        self.v = v
        for fields, share in self._seen():
            for p, phase in enumerate(plan.phases):
                tell = self._tell(p, share) if share else None
                dense.mirror(fields[p], phase.surface, tell)
        if plan.colours is not None:
            self._blend(plan.colours.set_of)

    def _as_one(self, v: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """Velocities with the mean of those phases that have one velocity."""
        groups = np.full(len(v), -1) if self.plan.rules is None else self.plan.rules.as_one
        for group in np.unique(groups[groups >= 0]):
            m = mass[groups == group][..., None]
            some, total = m.sum(0) > 0, m.sum(0)
            v[groups == group] = np.where(
                some, (m * v[groups == group]).sum(0) / np.where(some, total, 1.0), 0.0
            )
        return v

    def _seen(self) -> list[tuple[np.ndarray, float]]:
        """All velocities that particles gather, and how much of each they take up as their own."""
        found = [(self.v, self.mirrors)]
        if self.sharing is not None:
            found += [(self.flux, 0.0), (self.drift, 0.0)]
        if self.plan.keeps is not None:
            found.append((self.change, self.kept))
        return found

    def _blend(self, set_of: np.ndarray) -> None:
        for hue in self.hues:
            for one in np.unique(set_of[set_of >= 0]):
                total = hue[set_of == one].sum(0)
                some = total[..., 3:] > 0
                hue[set_of == one] = np.where(
                    some, total / np.where(some, total[..., 3:], 1.0), 0.0
                )

    # ---- nodes to particles ----------------------------------------------------------------------

    def gather(self, step: int) -> Report:
        """New velocities, gradients, states and positions, and what bounds the next step."""
        found = [self._gather(*one, step) for one in zip(self.groups, self.stencils, self.split,
                                                         strict=True)]  # fmt: skip
        wrong = [one for report in found for one in report.wrong]
        rate, far = (max(getattr(r, name) for r in found) for name in ("rate", "far"))
        # no sum is in quanta here, which turn and stress are for
        reach = max(r.reach[0] for r in found), 0.0, 0.0
        return Report(rate, far, reach, wrong, [])

    def restore(self, times: int) -> list[Beyond]:
        """Give the particles `times` what a step of no time has taken from their motion."""
        for group, stencil in zip(self.groups, self.stencils, strict=True):
            if len(group) and not group.plan.driven:
                field = self.v[group.plan.phase]
                v, L = self.dense.gather(field, stencil), self.dense.gather_slopes(field, stencil)
                for name, left in (("v", v), ("C", L.reshape(-1, 9))):
                    own = self._get(group, name)
                    self._put(group, name, own + times * (own - left))
        return []

    def _gather(self, group: Group, stencil: Stencil, split: np.ndarray, step: int) -> Report:
        plan, dense, p = group.plan, self.dense, group.plan.phase
        if not len(split):
            return Report(0.0, 0.0, (0.0,) * 3, [], [])
        if plan.driven:
            assert self.driven is not None
            return carry(group, self.driven, self.dt, step)
        for k in range(plan.coefficients):
            colour = self._get(group, "colour")
            colour[:, 3 * k : 3 * k + 3] = dense.gather(self.hues[k, p], stencil)[:, :3]
            self._put(group, "colour", colour)
        v, L = dense.gather(self.v[p], stencil), dense.gather_slopes(self.v[p], stencil)
        trace, moves = np.abs(np.trace(L, axis1=1, axis2=2)), v
        own = v
        if self.plan.keeps is not None:
            change = dense.gather(self.change[p], stencil)
            own = v + self.plan.keeps.over(self.dt) * (self._get(group, "v") + change - v)
        self._put(group, "v", own)
        self._put(group, "C", L.reshape(-1, 9))
        if plan.shares:
            moves = v + np.where(split[:, None], dense.gather(self.drift[p], stencil), 0.0)
            L = self._strain(group, stencil, split, L)
        if plan.space:
            J = np.exp(self._get(group, "theta")[:, 0])
            L = held(dense, self.mass[p], stencil, plan.space, J, L)
        law, rows = self._law(group), tuple(L.reshape(-1, 9).T)
        state = function(law, "advance")(law, self._state(group), rows, self.dt)
        self._put_state(group, state)
        if plan.followed:
            F = np.eye(3) + self._get(group, "F").reshape(-1, 3, 3)
            C = self._get(group, "C").reshape(-1, 3, 3)
            self._put(group, "F", (F + self.dt * C @ F - np.eye(3)).reshape(-1, 9))
        return self._move(group, moves, trace, law, state, step)

    def _strain(self, group, stencil, split, L) -> np.ndarray:
        """A fluid's volume changes by the flux of all that share its space; in pores its share of
        space is noted, and where there is more volume than space the volume ratio relaxes."""
        p, dense = group.plan.phase, self.dense
        slope = dense.gather_slopes(self.flux[p], stencil, moments=True)
        rate = np.trace(slope, axis1=1, axis2=2)
        if group.plan.porous:
            even = [dense.even(field[p])[..., None] for field in (self.share, self.full)]
            share, full = (dense.gather(field, stencil)[:, 0] for field in even)
            share = np.where(split, np.clip(share, LEAST_PORES, 1.0), 1.0)
            self._put(group, "share", share[:, None])
            rate = rate / share - RELAX * np.maximum(full - 1.0, 0.0)
        more = np.where(split, (rate - np.trace(L, axis1=1, axis2=2)) / 3.0, 0.0)
        return L + more[:, None, None] * np.eye(3)

    def _move(self, group, v, trace, law, state, step) -> Report:
        dx, dt, at = self.plan.dx, self.dt, group.index()
        J = np.broadcast_to(function(law, "volume_ratio")(law, state), trace.shape)
        wave2 = np.broadcast_to(function(law, "wave_speed2")(law, state), trace.shape)
        wave2 = wave2 * group.plan.slips
        if group.plan.porous:
            share = self._get(group, "share")[:, 0]
            wave2 = wave2 * (1.0 + (1.0 / share - 1.0) * group.plan.dense) + group.plan.stiff
        way = dt / dx * v
        whole, tame = (J > LEAST_J) & (J < MOST_J), (wave2 > -1.0) & (wave2 < FASTEST_WAVE**2)
        slow = np.abs(way).max(1) < 1.0
        good = whole & tame & slow
        dither = np.array([d * step % 1.0 for d in DITHER])
        units = np.floor(2.0**group.bits * np.where(good[:, None], way, 0.0) + dither)
        group.xi[:, at] += units.T.astype(group.xi.dtype)
        x = np.ldexp(group.xi[:, at].T.astype(np.float64), -group.bits)
        place = x + EDGE * np.repeat(group.block, group.count, axis=0)
        inside = ((place > -2.0) & (place < np.array(self.plan.cells) - 1.0)).all(1)
        speed = np.linalg.norm(v, axis=1)
        rates = (np.sqrt(np.maximum(wave2, 0.0)) + speed) / (self.plan.cfl * dx)
        rates = np.maximum(rates, np.maximum(speed / (FARTHEST * dx), trace / STRETCH))
        reason = np.select([~whole, ~tame, ~slow, ~inside], [CRUSHED, LOST, TOO_FAST, OUTSIDE], 0)
        wrong = [(int(group.ids[at[k]]), int(reason[k])) for k in np.flatnonzero(reason)]
        rate = float(np.where(good, rates, 0.0).max())
        reach = float(np.abs(v[good]).max(initial=0.0)), 0.0, 0.0
        return Report(rate, float(np.abs(x).max()), reach, wrong, [])

    # ---- a group's numbers, in double precision --------------------------------------------------

    @staticmethod
    def _get(group: Group, name: str) -> np.ndarray:
        """A channel of all particles: (n, width)."""
        return group.get(name, group.index()).astype(np.float64)

    @staticmethod
    def _put(group: Group, name: str, values: np.ndarray) -> None:
        group.put(name, group.index(), values)

    def _state(self, group: Group) -> tuple:
        return tuple(row.astype(np.float64) for row in group.law_state(group.index()))

    def _put_state(self, group: Group, state: tuple) -> None:
        at = 0
        for name, values in group.plan.state:
            rows = [np.broadcast_to(s, len(group)) for s in state[at : at + len(values)]]
            self._put(group, name, np.stack(rows, 1))
            at += len(values)

    @staticmethod
    def _law(group: Group) -> tuple:
        law: Any = group.plan.law
        return law._make(float(c) for c in law)

    @staticmethod
    def _stress(group: Group, law, state, C) -> np.ndarray:
        """Kirchhoff stress (n, 3, 3) [Pa]."""
        six = function(law, "stress")(law, state, tuple(C.T))
        xx, yy, zz, xy, xz, yz = (np.broadcast_to(c, len(C)) for c in six)
        return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
