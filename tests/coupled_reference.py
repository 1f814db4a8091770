"""The slow numpy twin of the coupled step: fluids that mix, sand that fluids flow through.

As tests/reference.py, for phases that all share space with one another: there is no contact. The
fluids' impulses are kept apart and shared by volume, fluids drift (Ren 2014, with the sign that
mixes) and relax, drag is solved by a general linear solver node by node, and the flux of volume of
all changes the fluids' density. All as arrays over phases and nodes.
"""

import numpy as np

from tests.reference import Reference
from vgmpi.materials.base import function

LEAST_PORES, LEAST_PART, RELAX = 0.05, 1e-3, 10.0


class CoupledReference(Reference):
    """bodies: one per phase, fluids and sands; fluid: (phases,) which; solid_share (phases,): grain
    volume per rest volume; porosity (phases,) of sands; drag: (phases, phases) [kg/(m3 s)];
    diffusion [m2/s] and slip time [s] of all fluids, which mix.
    """

    def __init__(self, cells, dx, gravity, walls, bodies, fluid, solid_share, porosity, drag,
                 diffusion, slip_time):  # fmt: skip
        super().__init__(cells, dx, gravity, walls, bodies)
        self.fluid, self.solid_share, self.porosity = map(np.array, (fluid, solid_share, porosity))
        self.drag, self.diffusion, self.slip_time = drag, diffusion, slip_time
        self.pores = [np.ones(len(body.x)) for body in bodies]  # share of space at the particles
        self.porous = [f and drag[k].any() for k, f in enumerate(fluid)]
        index = [np.arange(-1, n + 2) for n in cells]
        half = [np.where((i == 0) | (i == n), 0.5, 1.0) for i, n in zip(index, cells, strict=True)]
        self.space = dx**3 * half[0][:, None, None] * half[1][:, None] * half[2]
        self.dragged = 0  # nodes with drag in the last step

    def step(self, dt):
        """One step of dt [s]."""
        m, v, f, V, X = (np.array(field) for field in zip(*self._nodes(dt), strict=True))
        here = (m > 0)[..., None]
        v = np.where(here, v / np.where(here, m[..., None], 1.0) + dt * self.gravity, 0.0)
        v = self._pressure(m, v, f, V)
        v, drift = (np.where(here, part, 0.0) for part in self._mix(m, v, V, X, dt))
        self._drag(m, v, V, dt)
        for velocity in v:
            self._walls(velocity)
        self._all_to_particles(v, drift, V, dt)

    def _nodes(self, dt):
        """(mass, momentum, impulses kept apart, volume, offsets) of each phase."""
        for k, body in enumerate(self.bodies):
            if self.fluid[k]:
                none = np.zeros(len(body.x))
                mass, momentum = self._to_grid(body, dt, volume=none)
                _, impulse = self._to_grid(body, dt, m=none, volume=body.vol0 / self.pores[k])
                present = function(body.law, "volume_ratio")(body.law, tuple(body.state))
            else:  # a sand's own stress is its own
                mass, momentum = self._to_grid(body, dt)
                impulse, present = np.zeros_like(momentum), self.solid_share[k]
            yield mass, momentum, impulse, *self._offsets(body, present * body.vol0)

    def _shares(self, V):
        """(share of the space that fluids have, share of each phase among its kind, how full)."""
        fluid, grains = V[self.fluid].sum(0), V[~self.fluid].sum(0)
        pores = np.maximum(LEAST_PORES, 1.0 - grains / np.maximum(fluid + grains, self.space))
        pores = np.where((fluid > 0) & (grains > 0), pores, 1.0)
        kind = np.where(self.fluid[:, None, None, None], fluid, grains)
        part = np.where(V > 0, V / np.where(kind > 0, kind, 1.0), 0.0)
        return pores, part, np.where(fluid > 0, (fluid + grains) / self.space, 0.0)

    def _of_space(self, V):
        """Share of the space of each phase where there is fluid, and how full it is."""
        pores, part, fill = self._shares(V)
        mine = np.where(self.fluid[:, None, None, None], pores, 1.0 - pores)
        return pores, mine * part, fill

    def _pressure(self, m, v, f, V):
        _, part, _ = self._of_space(V)
        push = part[..., None] * f.sum(0)
        return v + push / np.where(m > 0, m, 1.0)[..., None]

    def _mix(self, m, v, V, X, dt):
        """(velocities, the drifts in them) after drift down the gradient of the shares of volume
        and relaxation of the slip."""
        mine = self.fluid[:, None, None, None]
        m, V, X = m * mine, V * mine, X * mine[..., None]

        def mean(u):
            mass = m.sum(0)
            return (m[..., None] * u).sum(0) / np.where(mass > 0, mass, 1.0)[..., None]

        volume = V.sum(0)
        volume = np.where(volume > 0, volume, 1.0)[..., None]
        part = V[..., None] / volume
        slope = 4.0 / self.dx**2 * (X - part * X.sum(0)) / volume
        u = -self.diffusion * slope / np.maximum(part, LEAST_PART)
        u = np.where(m[..., None] > 0, u - mean(u), 0.0)
        size, most = np.linalg.norm(u, axis=-1, keepdims=True), self.dx / (2 * dt)
        u *= np.minimum(1.0, most / np.where(size > 0, size, most))
        u = np.where(m[..., None] > 0, u - mean(u), 0.0)
        middle = mean(v)
        mixed = middle + (v - middle) / (1.0 + dt / self.slip_time) + u
        return np.where(mine[..., None], mixed, v), np.where(mine[..., None], u, 0.0)

    def _drag(self, m, v, V, dt):
        """(diag(m) + L(K)) v = m v*, K = dt c times the bulk volume that both fill."""
        _, part, _ = self._shares(V)
        both = (V[self.fluid].sum(0) > 0) & (V[~self.fluid].sum(0) > 0) & self.drag.any()
        self.dragged = int(both.sum())
        for node in map(tuple, np.argwhere(both)):
            at = (slice(None), *node)
            there = np.flatnonzero(m[at] > 0)
            K = np.zeros((len(there), len(there)))
            for a, sand in enumerate(there):
                for b, water in enumerate(there):
                    if self.fluid[sand] or not self.fluid[water]:
                        continue
                    n, of_sand, of_water = self.porosity[sand], V[at][sand], V[at][water]
                    bulk = of_sand / (1.0 - n) * part[at][water]
                    wet = of_water / n * part[at][sand]
                    K[a, b] = K[b, a] = dt * self.drag[sand, water] * min(bulk, wet)
            mass = m[at][there]
            matrix = np.diag(mass + K.sum(1)) - K
            v[(there, *node)] = np.linalg.solve(matrix, mass[:, None] * v[at][there])

    def _all_to_particles(self, v, drift, V, dt):
        """Drifts move particles and are no momentum of theirs."""
        pores, part, fill = self._of_space(V)
        flux = (part[..., None] * v).sum(0)
        self._mirror(flux)
        pores, fill = self._even(pores), self._even(fill)
        for k, body in enumerate(self.bodies):
            self._mirror(v[k])
            self._gather(body, v[k])
            C = body.C.copy()
            if self.fluid[k]:
                rate, share, full = (np.zeros(len(body.x)) for _ in range(3))
                for index, w, r in self._stencil(body.x):
                    rate += 4.0 / self.dx**2 * w * (flux[index] * r).sum(-1)
                    share += w * pores[index]
                    full += w * fill[index]
                if self.porous[k]:
                    self.pores[k] = np.clip(share, LEAST_PORES, 1.0)
                    rate = rate / self.pores[k] - RELAX * np.maximum(full - 1.0, 0.0)
                more = (rate - np.trace(C, axis1=1, axis2=2)) / 3.0
                C += more[:, None, None] * np.eye(3)
            self._move(body, C, dt)
            moved, gradient = body.v, body.C
            self._mirror(drift[k])
            here, body.x = body.x, body.x - dt * moved  # the weights are those before the move
            self._gather(body, drift[k])
            body.x, body.v, body.C = here, moved - body.v, gradient - body.C

    def _even(self, field):
        """The field with what mirroring walls show of it beyond them."""
        field = field.copy()
        for axis, kind, _, _, inside, beyond in self._ends():
            if kind != "separate":
                along = np.moveaxis(field, axis, 0)
                along[beyond] = along[inside]
        return field
