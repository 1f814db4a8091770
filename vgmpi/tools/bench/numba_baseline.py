"""Rival: plain loops compiled by numba, the way a first MLS-MPM code is written.

It is the control row: it needs nothing installed and never changes, so it shows what the machine
does to all rows.
"""

import math
import time

import numba
import numpy as np

import vgmpi.runtime.jit  # noqa: F401  (sets numba's cache folder first)
from vgmpi.runtime.compile_cache import njit_cached

from .dense_grid_baseline import Dense

compiled = njit_cached(fastmath=True, error_model="numpy")
shared = njit_cached(fastmath=True, error_model="numpy", inline="always")

# numba makes double precision of a single and a plain number
_1 = np.float32(1)
_4 = np.float32(4)
HALF = np.float32(0.5)
THREE_HALVES = np.float32(1.5)
THREE_QUARTERS = np.float32(0.75)


@shared
def _weights(x, w):
    """Compute weights w (3 axes, 3 nodes) of a position x (3,) [cells].

    The position becomes its distance from the base node.
    """
    for a in range(3):
        base = np.float32(int(x[a] - HALF))
        fx = x[a] - base
        w[a, 0] = HALF * (THREE_HALVES - fx) * (THREE_HALVES - fx)
        w[a, 1] = THREE_QUARTERS - (fx - _1) * (fx - _1)
        w[a, 2] = HALF * (fx - HALF) * (fx - HALF)
        x[a] = fx


@shared
def _fluid(p, C, J, dt, k, tau):
    """J and the Kirchhoff stress, p = k (J^-7 - 1)."""
    squares = C[p, 0, 0] * C[p, 0, 0] + C[p, 1, 1] * C[p, 1, 1] + C[p, 2, 2] * C[p, 2, 2]
    products = C[p, 0, 1] * C[p, 1, 0] + C[p, 0, 2] * C[p, 2, 0] + C[p, 1, 2] * C[p, 2, 1]
    trace = C[p, 0, 0] + C[p, 1, 1] + C[p, 2, 2]
    J[p] *= math.exp(dt * (trace - dt * (HALF * squares + products)))
    cube = J[p] * J[p] * J[p]
    tau[:] = 0
    t = -k * (_1 / (cube * cube * J[p]) - _1) * J[p]
    tau[0, 0] = tau[1, 1] = tau[2, 2] = t


@shared
def _elastic(p, C, F, dt, mu, lam, tau):
    """F and the Kirchhoff stress mu (F F^T - I) + lam ln J I."""
    for a in range(3):
        for b in range(3):
            c = C[p, a, 0] * F[p, 0, b] + C[p, a, 1] * F[p, 1, b] + C[p, a, 2] * F[p, 2, b]
            tau[a, b] = F[p, a, b] + dt * c
    for a in range(3):
        for b in range(3):
            F[p, a, b] = tau[a, b]
    f = F[p]
    det = (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )
    pressure = lam * math.log(det) - mu
    for a in range(3):
        for b in range(3):
            tau[a, b] = mu * (f[a, 0] * f[b, 0] + f[a, 1] * f[b, 1] + f[a, 2] * f[b, 2])
        tau[a, a] += pressure


@compiled
def p2g(is_fluid, x, v, C, F, J, grid, law, dx, dt, volume, mass):
    """Momentum and mass to grid (n, n, n, 4), cleared before. law: k, -  or  mu, lam."""
    first, second = law
    inverse = _1 / dx
    scale = dt * volume * _4 * inverse * inverse
    w = np.empty((3, 3), np.float32)
    tau = np.empty((3, 3), np.float32)
    A = np.empty((3, 3), np.float32)
    fx = np.empty(3, np.float32)
    grid[:] = 0
    for p in range(len(x)):
        if is_fluid:
            _fluid(p, C, J, dt, first, tau)
        else:
            _elastic(p, C, F, dt, first, second, tau)
        for a in range(3):
            fx[a] = x[p, a] * inverse
            for b in range(3):
                A[a, b] = mass * C[p, a, b] - scale * tau[a, b]
        bx, by, bz = int(fx[0] - HALF), int(fx[1] - HALF), int(fx[2] - HALF)
        _weights(fx, w)
        px, py, pz = mass * v[p, 0], mass * v[p, 1], mass * v[p, 2]
        for i in range(3):
            dist_x = (np.float32(i) - fx[0]) * dx
            for j in range(3):
                dist_y = (np.float32(j) - fx[1]) * dx
                wij = w[0, i] * w[1, j]
                for k in range(3):
                    dist_z = (np.float32(k) - fx[2]) * dx
                    wt = wij * w[2, k]
                    node = grid[bx + i, by + j, bz + k]
                    node[0] += wt * (px + A[0, 0] * dist_x + A[0, 1] * dist_y + A[0, 2] * dist_z)
                    node[1] += wt * (py + A[1, 0] * dist_x + A[1, 1] * dist_y + A[1, 2] * dist_z)
                    node[2] += wt * (pz + A[2, 0] * dist_x + A[2, 1] * dist_y + A[2, 2] * dist_z)
                    node[3] += wt * mass


@compiled
def update(grid, push):
    """Momentum to velocity; push [m/s] along z."""
    nodes = grid.reshape(-1, 4)
    for n in range(len(nodes)):
        m = nodes[n, 3]
        if m > 0:
            for a in range(3):
                nodes[n, a] /= m
            nodes[n, 2] += push


@compiled
def g2p(x, v, C, grid, dx, dt):
    """Velocity and its gradient from the grid; moves the particles."""
    inverse = _1 / dx
    four = _4 * inverse
    w = np.empty((3, 3), np.float32)
    fx = np.empty(3, np.float32)
    for p in range(len(x)):
        for a in range(3):
            fx[a] = x[p, a] * inverse
        bx, by, bz = int(fx[0] - HALF), int(fx[1] - HALF), int(fx[2] - HALF)
        _weights(fx, w)
        vx = vy = vz = np.float32(0)
        c00 = c01 = c02 = c10 = c11 = c12 = c20 = c21 = c22 = np.float32(0)
        for i in range(3):
            dist_x = np.float32(i) - fx[0]
            for j in range(3):
                dist_y = np.float32(j) - fx[1]
                wij = w[0, i] * w[1, j]
                for k in range(3):
                    dist_z = np.float32(k) - fx[2]
                    wt = wij * w[2, k]
                    node = grid[bx + i, by + j, bz + k]
                    gx, gy, gz = wt * node[0], wt * node[1], wt * node[2]
                    vx += gx
                    vy += gy
                    vz += gz
                    c00 += gx * dist_x
                    c01 += gx * dist_y
                    c02 += gx * dist_z
                    c10 += gy * dist_x
                    c11 += gy * dist_y
                    c12 += gy * dist_z
                    c20 += gz * dist_x
                    c21 += gz * dist_y
                    c22 += gz * dist_z
        v[p, 0], v[p, 1], v[p, 2] = vx, vy, vz
        C[p, 0, 0], C[p, 0, 1], C[p, 0, 2] = four * c00, four * c01, four * c02
        C[p, 1, 0], C[p, 1, 1], C[p, 1, 2] = four * c10, four * c11, four * c12
        C[p, 2, 0], C[p, 2, 1], C[p, 2, 2] = four * c20, four * c21, four * c22
        x[p, 0] += dt * vx
        x[p, 1] += dt * vy
        x[p, 2] += dt * vz


class Contestant(Dense):
    """Plain numba loops as a contestant."""

    versions = {"numba": numba.__version__}
    clock = staticmethod(time.thread_time)

    def build(self):
        """Allocate fields and compile the kernels."""
        real, law = np.float32, self.numbers["constants"]
        n, cells = self.count, self.numbers["cells"]
        self.C = np.zeros((n, 3, 3), real)
        self.F = np.zeros((n, 3, 3), real)
        self.J = np.zeros(n, real)
        self.grid = np.zeros((cells, cells, cells, 4), real)
        self.is_fluid = self.numbers["law"] == "fluid"
        pair = (law["k"], 0.0) if self.is_fluid else (law["mu"], law["lam"])
        self.pair = real(pair[0]), real(pair[1])
        self.dx, self.dt = real(self.numbers["dx"]), real(self.numbers["dt"])
        self.push = real(self.numbers["gravity"] * self.numbers["dt"])

    def load(self, x, v):
        """Load particles: positions [cells] and velocities [cells/s]."""
        self.x, self.v = x, v
        self.C[:] = 0
        self.F[:] = np.eye(3)
        self.J[:] = 1

    def step(self):
        """Advance one time step."""
        volume = np.float32(self.numbers["volume"])
        p2g(
            self.is_fluid, self.x, self.v, self.C, self.F, self.J, self.grid, self.pair,
            self.dx, self.dt, volume, np.float32(self.mass),
        )  # fmt: skip
        update(self.grid, self.push)
        g2p(self.x, self.v, self.C, self.grid, self.dx, self.dt)

    def state(self):
        """Return positions and velocities, shape (n, 3) each."""
        return self.x, self.v

    def grid_mass(self):
        """Return the total mass on the grid after P2G."""
        return float(self.grid[..., 3].sum(dtype=np.float64))
