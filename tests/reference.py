"""A slow CMPM in plain numpy, written from the equations: the solver's kernels are held to it.

One dense grid per phase over nodes -1 .. cells + 1 (one beyond each wall), all particles of a phase
at once, positions as plain numbers, laws as the plain Python functions of vgmpi.materials. Nothing
of the solver's blocks, patches, sorting or compiled code is used. Sources: APIC (Jiang 2015), MLS
force (Hu 2018, eq. 16 with quadratic B-splines: M = dx^2 / 4), contact by mean positions of the
particles; walls that stand on a node plane mirror what is inside.
"""

from dataclasses import dataclass

import numpy as np

from vgmpi.materials.base import function

TOUCH = 0.25  # gap [cells] below which two surfaces touch
LIGHT = 2.0**-21  # of a full cell: less of a phase at a node touches nothing


@dataclass
class Body:
    """Particles of one phase and material. x, v (n, 3) [m], [m/s]; C (n, 3, 3) [1/s]; vol0 (n,)
    [m3]; state: list of (n,) arrays.
    """

    law: tuple
    density: float
    x: np.ndarray
    v: np.ndarray
    C: np.ndarray
    vol0: np.ndarray
    state: list

    @property
    def mass(self):
        return self.density * self.vol0

    def stress(self):
        """Kirchhoff stress (n, 3, 3) [Pa]."""
        L = [self.C[:, a, b] for a in range(3) for b in range(3)]
        t = function(self.law, "stress")(self.law, tuple(self.state), L)
        xx, yy, zz, xy, xz, yz = (np.broadcast_to(c, self.vol0.shape) for c in t)
        return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)


class Reference:
    """The method on a dense grid. walls: (kind, friction) of west, east, south, north, floor, roof;
    friction: between the two phases, or of the one phase on the collider; collider: distance and
    normal as functions of points, see vgmpi/prepare/collider.py.
    """

    def __init__(self, cells, dx, gravity, walls, bodies, friction=0.0, master=0, collider=None):
        self.cells, self.dx, self.gravity = np.array(cells), dx, np.array(gravity)
        self.collider = collider
        self.walls, self.bodies = walls, bodies
        self.splines = False  # PIC, strains and forces by gradients of the B-splines
        self.friction, self.master = friction, master
        self.shape = tuple(n + 3 for n in cells)

    def step(self, dt):
        """One step of dt [s]."""
        grids = [self._to_grid(body, dt) for body in self.bodies]
        velocities = []
        for mass, momentum in grids:
            some = mass > 0
            v = np.where(some[..., None], momentum / np.where(some, mass, 1.0)[..., None], 0.0)
            velocities.append(v + dt * self.gravity * some[..., None])
        if len(self.bodies) == 2:
            self._contact(velocities, [mass for mass, _ in grids])
        elif self.collider is not None:
            self._collide(velocities[0], grids[0][0])
        for body, v in zip(self.bodies, velocities, strict=True):
            self._walls(v)
            self._mirror(v)
            self._to_particles(body, v, dt)

    def limits(self, cfl):
        """What limits the step [s]: waves, particles that fly too far, volumes that change too
        much.
        """
        rates = {"wave": 0.0, "speed": 0.0, "volume": 0.0}
        for body in self.bodies:
            c = np.sqrt(function(body.law, "wave_speed2")(body.law, tuple(body.state)))
            speed = np.linalg.norm(body.v, axis=1)
            trace = np.abs(np.trace(body.C, axis1=1, axis2=2))
            rates["wave"] = max(rates["wave"], ((c + speed) / (cfl * self.dx)).max())
            rates["speed"] = max(rates["speed"], (speed / (0.3 * self.dx)).max())
            rates["volume"] = max(rates["volume"], (trace / 0.1).max())
        return {name: 1.0 / rate for name, rate in rates.items()}

    def _stencil(self, x):
        """27 tuples of (grid index, weight (n,), node minus particle (n, 3) [m])."""
        base = np.floor(x / self.dx - 0.5).astype(int)
        f = x / self.dx - base  # 0.5 .. 1.5
        w = [0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2]
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    node = base + (i, j, k)
                    index = tuple((node + 1).T)  # the grid begins at node -1
                    yield index, w[i][:, 0] * w[j][:, 1] * w[k][:, 2], node * self.dx - x

    def _slopes(self, x):
        """27 times the gradient of the weight (n, 3) [1/m], in the order of `_stencil`."""
        f = x / self.dx - np.floor(x / self.dx - 0.5)
        w = [0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2]
        d = [(f - 1.5) / self.dx, -2.0 * (f - 1.0) / self.dx, (f - 0.5) / self.dx]
        for i, j, k in np.ndindex(3, 3, 3):
            x, y, z = d[i][:, 0], d[j][:, 1], d[k][:, 2]
            u, v, w_ = w[i][:, 0], w[j][:, 1], w[k][:, 2]
            yield np.stack([x * v * w_, u * y * w_, u * v * z], 1)

    def _to_grid(self, body, dt, m=None, volume=None):
        """Mass and momentum with the stress's impulses at the nodes; m, volume (n,): in place of
        the masses, and of the volumes that the stress acts on.
        """
        mass, momentum = np.zeros(self.shape), np.zeros((*self.shape, 3))
        m = body.mass if m is None else m
        volume = body.vol0 if volume is None else volume
        pull = dt * volume[:, None, None] * body.stress()
        affine = 0.0 * body.C if self.splines else body.C
        for (index, w, r), slope in zip(self._stencil(body.x), self._slopes(body.x), strict=True):
            if not self.splines:
                slope = 4.0 / self.dx**2 * w[:, None] * r
            carried = body.v + np.einsum("nab,nb->na", affine, r)
            np.add.at(mass, index, w * m)
            push = (w * m)[:, None] * carried - np.einsum("nab,nb->na", pull, slope)
            np.add.at(momentum, index, push)
        self._fold(mass[..., None], lambda kind, axis: [1.0])
        self._fold(momentum, self._sign)
        return mass, momentum

    @staticmethod
    def _sign(kind, axis):
        """What a mirror does to a vector."""
        sign = -np.ones(3) if kind == "stick" else np.ones(3)
        sign[axis] = -1.0
        return sign

    def _ends(self):
        """(axis, kind, friction, node plane of the wall, one inside, one beyond) of every wall."""
        for axis in range(3):
            yield axis, *self.walls[2 * axis], 1, 2, 0
            last = self.cells[axis] + 1
            yield axis, *self.walls[2 * axis + 1], last, last - 1, last + 1

    def _fold(self, field, sign):
        """Add what fell beyond the mirroring walls to the mirror image of its node."""
        for axis, kind, _, _, inside, beyond in self._ends():
            if kind != "separate":
                along = np.moveaxis(field, axis, 0)
                along[inside] += along[beyond] * sign(kind, axis)
                along[beyond] = 0.0

    def _walls(self, v):
        for axis, kind, friction, wall, _, beyond in self._ends():
            along = np.moveaxis(v, axis, 0)
            inward = 1.0 if wall == 1 else -1.0
            if kind == "stick":
                along[wall] = 0.0
            elif kind == "slip":
                along[wall, ..., axis] = 0.0
            else:
                for plane in (wall, beyond):
                    u = along[plane]
                    push = np.maximum(-inward * u[..., axis], 0.0)
                    hit = push > 0
                    u[..., axis] = np.where(hit, 0.0, u[..., axis])
                    size = np.linalg.norm(u, axis=-1)
                    keep = np.maximum(size - friction * push, 0.0) / np.where(size > 0, size, 1.0)
                    u *= np.where(hit, keep, 1.0)[..., None]

    def _mirror(self, v):
        """Velocities beyond the walls as the particles near them see them."""
        for axis, kind, _, wall, inside, beyond in self._ends():
            along = np.moveaxis(v, axis, 0)
            if kind != "separate":
                along[beyond] = along[inside] * self._sign(kind, axis)
            else:
                inward = 1.0 if wall == 1 else -1.0
                least = -inward * along[inside][..., axis]
                along[beyond][..., axis] = inward * np.maximum(
                    inward * along[beyond][..., axis], least
                )

    def _to_particles(self, body, v, dt):
        self._gather(body, v)
        self._move(body, body.C, dt)

    def _gather(self, body, v):
        """Velocity and its gradient from the nodes."""
        body.v = np.zeros_like(body.x)
        body.C = np.zeros((len(body.x), 3, 3))
        for (index, w, r), slope in zip(self._stencil(body.x), self._slopes(body.x), strict=True):
            seen = v[index]
            body.v += w[:, None] * seen
            if not self.splines:
                slope = 4.0 / self.dx**2 * w[:, None] * r
            body.C += np.einsum("na,nb->nab", seen, slope)

    @staticmethod
    def _move(body, C, dt):
        """New positions, and states by the velocity gradient C (n, 3, 3)."""
        body.x = body.x + dt * body.v
        L = [C[:, a, b] for a in range(3) for b in range(3)]
        body.state = list(function(body.law, "advance")(body.law, tuple(body.state), L, dt))

    # --- contact of two phases ---

    def _offsets(self, body, vol=None):
        """sum V w (...,) [m3] and sum V w (x_p - x_i) (..., 3) [m4] at the nodes; V: rest volumes,
        or vol (n,).
        """
        vol = body.vol0 if vol is None else vol
        volume, offset = np.zeros(self.shape), np.zeros((*self.shape, 3))
        for index, w, r in self._stencil(body.x):
            np.add.at(volume, index, w * vol)
            np.add.at(offset, index, -(w * vol)[:, None] * r)
        self._fold(volume[..., None], lambda kind, axis: [1.0])
        self._fold(offset, lambda kind, axis: self._sign("slip", axis))
        for axis, kind, _, wall, _, _ in self._ends():
            if kind != "separate":  # the mirror image cancels it
                np.moveaxis(offset, axis, 0)[wall, ..., axis] = 0.0
        return volume, offset

    def _contact(self, velocities, masses):
        """Change the velocities where two phases touch and approach; node by node."""
        least = [LIGHT * body.density * self.dx**3 for body in self.bodies]
        where = np.argwhere((masses[0] > least[0]) & (masses[1] > least[1]))
        a, b = self.master, 1 - self.master
        V, X = zip(*(self._offsets(body) for body in self.bodies), strict=True)
        for node in map(tuple, where):
            size = np.linalg.norm(X[a][node])
            if size > 1e-6 * self.dx * V[a][node]:
                n = -X[a][node] / size
            else:
                size = np.linalg.norm(X[b][node])
                if not size > 1e-6 * self.dx * V[b][node]:
                    continue
                n = X[b][node] / size
            ma = -(X[a][node] @ n) / (V[a][node] * self.dx)
            mb = (X[b][node] @ n) / (V[b][node] * self.dx)
            if surface(ma) + surface(mb) > TOUCH:
                continue
            va, vb = velocities[a][node], velocities[b][node]
            reduced = masses[a][node] * masses[b][node] / (masses[a][node] + masses[b][node])
            approach = (va - vb) @ n
            if approach <= 0.0:
                continue
            slide = va - vb - approach * n
            size = np.linalg.norm(slide)
            brake = min(1.0, self.friction * approach / size) if size > 0 else 0.0
            push = reduced * (approach * n + brake * slide)
            velocities[a][node] = va - push / masses[a][node]
            velocities[b][node] = vb + push / masses[b][node]

    def _collide(self, velocity, mass):
        """As `_contact`, with a rigid collider at rest whose surface is known."""
        body = self.bodies[0]
        volume, offset = self._offsets(body)
        for node in map(tuple, np.argwhere(mass > LIGHT * body.density * self.dx**3)):
            point = (np.array([node]) - 1) * self.dx
            n = self.collider.normal(point)[0]
            m = (offset[node] @ n) / (volume[node] * self.dx)
            if self.collider.distance(point)[0] / self.dx + surface(m) > TOUCH:
                continue
            v = velocity[node]
            into = -(v @ n)
            if into > 0.0:
                slide = v + into * n
                size = np.linalg.norm(slide)
                keep = max(0.0, 1.0 - self.friction * into / size) if size > 0 else 0.0
                velocity[node] = keep * slide


def surface(m):
    """Distance [cells] of a node outside a half space whose particles lie m cells off on average
    (the fit that the contact rule is defined by).
    """
    if m >= 0.75:
        return min((m - 0.375) / 0.75, 1.5)
    if m <= 0.0:
        return -1.5
    s = np.cbrt(m)
    return -1.5 + 1.524778 * s + 0.998001 * s**2 - 1.124705 * s**3 + 0.933773 * s**4
