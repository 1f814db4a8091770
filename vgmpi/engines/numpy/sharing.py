"""Phases that share space: fluids that mix, sand that fluids flow through. Formulas and sources:
docs/theory.md. All arrays run over phases, then nodes.
"""

import numpy as np

from ...couplings.base import Rules
from ...kernels.couple import LEAST_PART, LEAST_PORES
from .dense import Dense


def _over(a, b):
    """a / b, 0 where b is not above 0."""
    return np.where(b > 0, a / np.where(b > 0, b, 1.0), 0.0)


class Sharing:
    """The sets of a scene's rules, one after the other."""

    def __init__(self, rules: Rules, dense: Dense):
        self.rules, self.dense, self.dx = rules, dense, dense.dx
        self.sets = [np.flatnonzero(rules.together == k) for k in range(rules.sets)]
        self.fluid = np.asarray(rules.fluid, bool)[:, None, None, None]

    def volumes(self, mass: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """Of each phase [m3]: fluids as counted by the nodes, sands by the mass of their grains."""
        grains = self.rules.volume[:, None, None, None] * mass
        return np.where(self.fluid, np.maximum(counted, 0.0), grains)

    def _parts(self, members, mass, V):
        """Of one set: volumes, fluids' and grains' sum, the fluids' share of space."""
        V = np.where(mass[members] > 0, V[members], 0.0)
        wet = self.fluid[members]
        fluid, grains = np.where(wet, V, 0).sum(0), np.where(wet, 0, V).sum(0)
        share = np.maximum(1.0 - grains / np.maximum(fluid + grains, self.dense.space), LEAST_PORES)
        return V, fluid, grains, np.where((fluid > 0) & (grains > 0), share, 1.0)

    def act(self, v, mass, forces, V, offset, dt: float) -> np.ndarray:
        """Change velocities v (phases, ..., 3): pressure, drift and slip, drag. forces: impulses
        kept apart. Returns the drifts in them."""
        rules, drift = self.rules, np.zeros_like(v)
        for members in self.sets:
            m = mass[members]
            shared = (m > 0).sum(0) > 1
            numbers = [(g, rules.diffusion[g], rules.slip_time[g]) for g in range(rules.mixes)]
            for g, D, _ in numbers:
                if rules.printed_mix[g]:
                    self._mix(g, v, mass, V, offset, shared, D, 0.0, -1.0, dt)
            self._pressure(members, v, mass, forces, V, shared)
            for g, D, slip in numbers:
                if not rules.printed_mix[g]:
                    u = self._mix(
                        g, v, mass, V, offset, shared, D, 1.0 / (1.0 + dt / slip), 1.0, dt
                    )
                    drift += u
            self._drag(members, v, mass, V, dt)
        return drift

    def _pressure(self, members, v, mass, forces, V, shared):
        """All fluids' impulses, to each phase by its share of the space."""
        own, fluid, grains, share = self._parts(members, mass, V)
        wet = self.fluid[members]
        total = np.where(wet[..., None], forces[members], 0.0).sum(0)
        part = np.where(wet, share * _over(own, fluid), (1.0 - share) * _over(own, grains))
        m = mass[members]
        alone = _over(forces[members], m[..., None])
        v[members] += np.where(
            shared[..., None], _over(part[..., None] * total, m[..., None]), alone
        )

    def _mix(self, g, v, mass, V, offset, shared, diffusion, keep, sign, dt) -> np.ndarray:
        """Fluids of group g drift (Ren 2014) and keep the share `keep` of what else differs in
        their velocities. Returns the drifts."""
        mine = (self.rules.mix == g)[:, None, None, None]
        if mine.sum() < 2:
            return np.zeros_like(v)
        m = np.where(mine, mass, 0.0)[..., None]
        here = ((m.sum(0) > 0) & shared[..., None])[None]
        mean = _over((m * v).sum(0), m.sum(0))
        u = np.zeros_like(v)
        if diffusion > 0:
            u = self._drift(mine, m, V, offset, sign * diffusion, dt)
        u = np.where(here & mine[..., None], u, 0.0)
        v[:] = np.where(here & mine[..., None], mean + keep * (v - mean) + u, v)
        return u

    def _drift(self, mine, m, V, offset, strength, dt):
        """u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l), none faster than half a cell in dt;
        their momenta sum to zero."""
        V = np.where(mine & (m[..., 0] > 0), V, 0.0)[..., None]
        X = np.where(mine[..., None], offset, 0.0)
        part = _over(V, V.sum(0))
        slope = 4.0 / self.dx**2 * _over(X - part * X.sum(0), np.broadcast_to(V.sum(0), X.shape))
        u = np.where(m > 0, -strength * slope / np.maximum(part, LEAST_PART), 0.0)
        u = u - _over((m * u).sum(0), m.sum(0))
        size, most = np.linalg.norm(u, axis=-1, keepdims=True), self.dx / (2.0 * dt)
        u = u * np.where(size > most, most / np.where(size > 0, size, 1.0), 1.0)
        return u - _over((m * u).sum(0), m.sum(0))

    def _drag(self, members, v, mass, V, dt):
        """(diag(m) + L(K)) v = m v*, K = dt c times the bulk volume that both fill, by a general
        solver at each node."""
        rules = self.rules
        if not rules.drags:
            return
        own, fluid, grains, _ = self._parts(members, mass, V)
        wet = np.asarray(rules.fluid, bool)[members]
        for node in map(tuple, np.argwhere((fluid > 0) & (grains > 0))):
            at = (slice(None), *node)
            m, part = mass[(members, *node)], own[at]
            K = np.zeros((len(members), len(members)))
            for a, b in np.argwhere(~wet[:, None] & wet[None, :] & (part[:, None] * part > 0)):
                strength, n = rules.drag[members[a], members[b]], rules.porosity[members[a]]
                bulk = part[a] / (1.0 - n) * (part[b] / fluid[node])
                filled = part[b] / n * (part[a] / grains[node])
                K[a, b] = K[b, a] = dt * strength * min(bulk, filled)
                if rules.printed_drag[members[a], members[b]]:
                    K[a, b] = K[b, a] = strength * m[a] * m[b] / (m[a] + m[b])
            there = np.flatnonzero(m > 0)
            K = K[np.ix_(there, there)]
            matrix = np.diag(m[there] + K.sum(1)) - K
            rows = (members[there], *node)
            v[rows] = np.linalg.solve(matrix, m[there, None] * v[rows])

    def flux(self, v, mass, V):
        """(flux of volume [m/s], fluids' share of space, how full the space is) as each phase's
        particles gather them: (phases, ...)."""
        flux, share, full = v.copy(), np.ones(mass.shape), np.zeros(mass.shape)
        for members in self.sets:
            own, fluid, grains, pores = self._parts(members, mass, V)
            wet = self.fluid[members]
            part = np.where(wet, pores * _over(own, fluid), (1.0 - pores) * _over(own, grains))
            total = (part[..., None] * v[members]).sum(0)
            several = ((mass[members] > 0).sum(0) > 1) & (fluid > 0)
            flux[members] = np.where(several[..., None], total, v[members])
            share[members] = pores
            full[members] = (fluid + grains) / self.dense.space
        return flux, share, full
