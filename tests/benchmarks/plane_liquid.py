"""A liquid in the plane, with an explicit or an implicit pressure, for `implicit_pressure`.

It is a study of a method before the solver has it, and no part of the solver: quadratic B-splines,
APIC, slip walls around a tank, lengths in cells. Pressures belong to the cells between nodes. The
explicit liquid takes them from the volume ratio of its particles, the implicit one from a system
over the cells, by sweeps of a fixed number:

    (V / K) p + dt^2 V D M^-1 D^T V p = (V / K) p_n - dt V D v

(V: filled share of a cell, K: stiffness, D: divergence of nodal velocities, M: masses of nodes, v:
nodal velocities before the pressure acts). A second system of the same kind moves particles until
no cell inside of the liquid is over-full or under-full.
"""

import time
from dataclasses import dataclass, field

import numpy as np
from numba import njit

GHOSTS = 4  # nodes and cells beyond each wall
FASTMATH = {"cache": True, "fastmath": True}
SURFACE_FILL = 0.5  # cells with less have no pressure
MAX_EIGENVALUE = 2.0  # of the systems, each row over its diagonal
MAX_MOVE = 0.3  # [cells] of a particle by the second system
SHIFT, MAX_SHIFT, SHIFT_FILL = 0.1, 0.05, 1.02  # of the explicit liquid
SHIFT_INTERVAL = 3  # steps between its shifts
RELAXED_FILLS = 0.6, 0.9  # between which the explicit liquid's volume ratio begins to count


@njit(**FASTMATH)
def spline_weights(x):
    """Base node and weights of the quadratic B-spline."""
    base = int(np.floor(x - 0.5))
    r = x - 0.5 - base
    return base, (0.5 * (1 - r) * (1 - r), 0.75 - (r - 0.5) * (r - 0.5), 0.5 * r * r)


@njit(**FASTMATH)
def cell_weights(x):
    """Lower cell and the weight of the upper one, of a number between the middles of cells."""
    lower = int(np.floor(x - 0.5))
    return lower + GHOSTS, x - 0.5 - lower


@njit(**FASTMATH)
def scatter(x, v, C, theta, volume, mass, momentum, filled, strained):
    """Sum mass and momentum at nodes, volume and volume times ln J in cells."""
    for field_values in (mass, filled, strained):
        field_values[:] = 0
    momentum[:] = 0
    for p in range(len(x)):
        bi, wx = spline_weights(x[p, 0])
        bj, wy = spline_weights(x[p, 1])
        for a in range(3):
            for b in range(3):
                m, dx, dy = wx[a] * wy[b] * volume, bi + a - x[p, 0], bj + b - x[p, 1]
                i, j = bi + a + GHOSTS, bj + b + GHOSTS
                mass[i, j] += m
                momentum[0, i, j] += m * (v[p, 0] + C[p, 0] * dx + C[p, 1] * dy)
                momentum[1, i, j] += m * (v[p, 1] + C[p, 2] * dx + C[p, 3] * dy)
        i, r = cell_weights(x[p, 0])
        j, s = cell_weights(x[p, 1])
        for a in range(2):
            for b in range(2):
                share = volume * (r if a else 1 - r) * (s if b else 1 - s)
                filled[i + a, j + b] += share
                strained[i + a, j + b] += share * theta[p]


@njit(**FASTMATH)
def push(pressure, filled, inverse_mass, velocity, n, dt):
    """Add to the nodes what the pressures of their cells do within dt; walls stay at rest."""
    for i in range(n[0] + 1):
        for j in range(n[1] + 1):
            I, J = i + GHOSTS, j + GHOSTS
            factor = 0.5 * dt * inverse_mass[I, J]
            if factor == 0:
                continue
            a, b, c, d = 0.0, 0.0, 0.0, 0.0
            if i > 0 and j > 0:
                a = filled[I - 1, J - 1] * pressure[I - 1, J - 1]
            if i > 0 and j < n[1]:
                b = filled[I - 1, J] * pressure[I - 1, J]
            if i < n[0] and j > 0:
                c = filled[I, J - 1] * pressure[I, J - 1]
            if i < n[0] and j < n[1]:
                d = filled[I, J] * pressure[I, J]
            if 0 < i < n[0]:
                velocity[0, I, J] += factor * (a + b - c - d)
            if 0 < j < n[1]:
                velocity[1, I, J] += factor * (a + c - b - d)


@njit(**FASTMATH)
def divergence(u, n, filled, out):
    """Divergence of nodal velocities in the cells; 0 in empty ones."""
    for i in range(GHOSTS, n[0] + GHOSTS):
        for j in range(GHOSTS, n[1] + GHOSTS):
            if filled[i, j] == 0:
                out[i, j] = 0.0
                continue
            along_x = u[0, i + 1, j] + u[0, i + 1, j + 1] - u[0, i, j] - u[0, i, j + 1]
            along_y = u[1, i, j + 1] + u[1, i + 1, j + 1] - u[1, i, j] - u[1, i + 1, j]
            out[i, j] = 0.5 * (along_x + along_y)


@njit(**FASTMATH)
def solve_pressure(p, right, filled, inverse_mass, active, compliance, dt, n, sweeps, least):
    """Chebyshev sweeps for V (compliance p + dt^2 D M^-1 D^T V p) = V right, from p on.

    Sums of a cell have one order, and the number of sweeps is fixed, so that nothing depends on how
    cells are spread over processors. `least` is the least eigenvalue that the sweeps reduce.
    """
    u = np.zeros((2, *p.shape))
    response, step = np.zeros_like(p), np.zeros_like(p)
    middle, half = 0.5 * (MAX_EIGENVALUE + least), 0.5 * (MAX_EIGENVALUE - least)
    rho, weight, inertia = half / middle, 1.0 / middle, 0.0
    for sweep in range(sweeps):
        u[:] = 0
        push(p, filled, inverse_mass, u, n, dt)
        divergence(u, n, filled, response)
        if sweep:
            following = 1.0 / (2.0 * middle / half - rho)
            inertia, weight = following * rho, 2.0 * following / half
            rho = following
        for i in range(GHOSTS, n[0] + GHOSTS):
            for j in range(GHOSTS, n[1] + GHOSTS):
                if not active[i, j]:
                    continue
                own = 0.0
                for a in range(2):
                    for b in range(2):
                        axes = (0 < i + a - GHOSTS < n[0]) + (0 < j + b - GHOSTS < n[1])
                        own += 0.25 * inverse_mass[i + a, j + b] * axes
                diagonal = compliance + dt * dt * own * filled[i, j]
                residual = right[i, j] - compliance * p[i, j] - dt * response[i, j]
                step[i, j] = weight * residual / diagonal + inertia * step[i, j]
                p[i, j] += step[i, j]


@njit(**FASTMATH)
def gather(x, v, C, theta, u, div, moves, dt, n):
    """Advect the particles; return the largest speed [cells/s]."""
    fastest = 0.0
    speed, way, gradient = np.zeros(2), np.zeros(2), np.zeros(4)
    for p in range(len(x)):
        bi, wx = spline_weights(x[p, 0])
        bj, wy = spline_weights(x[p, 1])
        speed[:], way[:], gradient[:] = 0.0, 0.0, 0.0
        for a in range(3):
            for b in range(3):
                w, dx, dy = wx[a] * wy[b], bi + a - x[p, 0], bj + b - x[p, 1]
                i, j = bi + a + GHOSTS, bj + b + GHOSTS
                for k in range(2):
                    speed[k] += w * u[k, i, j]
                    way[k] += w * moves[k, i, j]
                    gradient[2 * k] += 4 * w * u[k, i, j] * dx
                    gradient[2 * k + 1] += 4 * w * u[k, i, j] * dy
        C[p] = gradient
        i, r = cell_weights(x[p, 0])
        j, s = cell_weights(x[p, 1])
        low = (1 - s) * div[i, j] + s * div[i, j + 1]
        theta[p] += dt * ((1 - r) * low + r * ((1 - s) * div[i + 1, j] + s * div[i + 1, j + 1]))
        for k in range(2):
            v[p, k] = speed[k]
            moved = x[p, k] + dt * speed[k] + min(max(way[k], -MAX_MOVE), MAX_MOVE)
            x[p, k] = min(max(moved, 1e-6), n[k] - 1e-6)
        stretching = 0.5 * max(abs(gradient[0]), abs(gradient[3]))
        fastest = max(fastest, max(abs(speed[0]), abs(speed[1])) + stretching)
    return fastest


@njit(**FASTMATH)
def take(values, x, out):
    """Interpolate a number of the cells at the particles."""
    for p in range(len(x)):
        i, r = cell_weights(x[p, 0])
        j, s = cell_weights(x[p, 1])
        low = (1 - s) * values[i, j] + s * values[i, j + 1]
        out[p] = (1 - r) * low + r * ((1 - s) * values[i + 1, j] + s * values[i + 1, j + 1])


@njit(**FASTMATH)
def shift_particles(x, v, C, excess, n):
    """Move particles away from over-full nodes, and their velocities with them."""
    for p in range(len(x)):
        bi, wx = spline_weights(x[p, 0])
        bj, wy = spline_weights(x[p, 1])
        rx, ry = x[p, 0] - 0.5 - bi, x[p, 1] - 0.5 - bj
        ex, ey = (rx - 1, 1 - 2 * rx, rx), (ry - 1, 1 - 2 * ry, ry)
        sx, sy = 0.0, 0.0
        for a in range(3):
            for b in range(3):
                e = SHIFT * excess[bi + a + GHOSTS, bj + b + GHOSTS]
                sx -= e * ex[a] * wy[b]
                sy -= e * wx[a] * ey[b]
        length = np.hypot(sx, sy)
        if length == 0:
            continue
        factor = min(1.0, MAX_SHIFT / length)
        sx, sy = factor * sx, factor * sy
        x[p, 0] = min(max(x[p, 0] + sx, 0.02), n[0] - 0.02)
        x[p, 1] = min(max(x[p, 1] + sy, 0.02), n[1] - 0.02)
        v[p, 0] += C[p, 0] * sx + C[p, 1] * sy
        v[p, 1] += C[p, 2] * sx + C[p, 3] * sy


@njit(**FASTMATH)
def reflect(values, n, signs=(1, 1), centers=False):
    """Fill ghosts beyond the walls by images; `centers` for numbers of cells."""
    gap = 0 if centers else 1
    right, top = GHOSTS + n[0] - 1, GHOSTS + n[1] - 1
    for k in range(GHOSTS - 1):
        values[GHOSTS - 1 - k] = signs[0] * values[GHOSTS + gap + k]
        values[right + 1 + gap + k] = signs[0] * values[right - k]
    for k in range(GHOSTS - 1):
        values[:, GHOSTS - 1 - k] = signs[1] * values[:, GHOSTS + gap + k]
        values[:, top + 1 + gap + k] = signs[1] * values[:, top - k]


@njit(**FASTMATH)
def fold(values, n, signs=(1, 1), centers=False):
    """Add what particles gave beyond the walls to the images inside."""
    gap = 0 if centers else 1
    right, top = GHOSTS + n[0] - 1, GHOSTS + n[1] - 1
    for k in range(GHOSTS - 1):
        values[GHOSTS + gap + k] += signs[0] * values[GHOSTS - 1 - k]
        values[right - k] += signs[0] * values[right + 1 + gap + k]
        values[GHOSTS - 1 - k], values[right + 1 + gap + k] = 0.0, 0.0
    for k in range(GHOSTS - 1):
        values[:, GHOSTS + gap + k] += signs[1] * values[:, GHOSTS - 1 - k]
        values[:, top - k] += signs[1] * values[:, top + 1 + gap + k]
        values[:, GHOSTS - 1 - k], values[:, top + 1 + gap + k] = 0.0, 0.0


@dataclass
class PlaneLiquid:
    """A liquid of density 1 in a tank.

    Attributes:
        n: Cells along both axes.
        x, v: Positions [cells] and velocities [cells/s], shape (particles, 2).
        stiffness: Bulk modulus over density [cells^2/s^2].
        gravity: [cells/s^2].
        implicit: Whether the pressure is implicit.
        cfl: Cells that the fastest particle (explicit: wave) crosses in a step.
        sweeps: Sweeps of the pressure system and of the one for positions.
        least: Least eigenvalue that the sweeps of each reduce.
        volume: Area of a particle [cells^2].
    """

    n: tuple[int, int]
    x: np.ndarray
    v: np.ndarray
    stiffness: float
    gravity: float
    implicit: bool = True
    cfl: float = 0.4
    sweeps: tuple[int, int] = (20, 10)
    least: tuple[float, float] = (0.05, 0.1)
    volume: float = 0.25
    time: float = 0.0
    steps: int = 0
    seconds: float = 0.0  # of the processor
    fields: dict = field(default_factory=dict)

    def __post_init__(self):
        shape = tuple(k + 1 + 2 * GHOSTS for k in self.n)
        names = "mass filled strained pressure divergence".split()
        self.fields = {name: np.zeros(shape) for name in names}
        self.fields["momentum"] = np.zeros((2, *shape))
        self.C = np.zeros((len(self.x), 4))
        self.theta = np.zeros(len(self.x))
        self.fastest = float(np.abs(self.v).max())
        self.cells = tuple(slice(GHOSTS, GHOSTS + k) for k in self.n)
        self.nodes = tuple(slice(GHOSTS, GHOSTS + k + 1) for k in self.n)

    def rest_in_its_weight(self, depth: float) -> None:
        """Compress the particles to hydrostatic pressure below a surface [cells]."""
        self.theta = -self.gravity * np.maximum(depth - self.x[:, 1], 0) / self.stiffness

    def advance(self, end: float) -> None:
        """Advance to a time [s]."""
        while self.time < end - 1e-12:
            speed = max(self.fastest, np.sqrt(2 * self.gravity))  # what falls through a cell has it
            if not self.implicit:
                speed = self.fastest + np.sqrt(self.stiffness)
            count = max(1.0, np.ceil((end - self.time) * speed / self.cfl - 1e-9))
            began = time.process_time()
            self._step((end - self.time) / count)
            self.seconds += time.process_time() - began

    def _step(self, dt: float) -> None:
        f, n = self.fields, self.n
        mass, filled, u = f["mass"], f["filled"], f["momentum"]
        scatter(self.x, self.v, self.C, self.theta, self.volume, mass, u, filled, f["strained"])
        fold(mass, n)
        fold(u[0], n, (-1, 1))
        fold(u[1], n, (1, -1))
        fold(filled, n, centers=True)
        fold(f["strained"], n, centers=True)
        inverse_mass = np.zeros_like(mass)
        np.divide(1.0, mass, out=inverse_mass, where=mass > 1e-12)
        u *= inverse_mass
        u[1] -= dt * self.gravity * (mass > 1e-12)
        for k in range(2):  # slip walls
            rows = np.moveaxis(u[k], k, 0)
            rows[: GHOSTS + 1] = 0
            rows[GHOSTS + n[k] :] = 0
        strain = np.zeros_like(filled)
        np.divide(f["strained"], filled, out=strain, where=filled > 1e-12)
        moves = np.zeros_like(u)
        if self.implicit:
            moves = self._solve(dt, u, inverse_mass, strain)
        else:
            f["pressure"][:] = self.stiffness / 7 * np.expm1(-7 * strain)
        push(f["pressure"], filled, inverse_mass, u, n, dt)
        divergence(u, n, filled, f["divergence"])
        for vectors in (u, moves):
            reflect(vectors[0], n, (-1, 1))
            reflect(vectors[1], n, (1, -1))
        reflect(f["divergence"], n, centers=True)
        self.fastest = gather(self.x, self.v, self.C, self.theta, u, f["divergence"], moves, dt, n)
        self._keep_volume()
        self.time += dt
        self.steps += 1

    def _solve(self, dt: float, u, inverse_mass, strain) -> np.ndarray:
        """Find the pressures and return the displacements of the nodes [cells]."""
        f, n, filled = self.fields, self.n, self.fields["filled"]
        active = np.zeros(filled.shape, bool)
        active[self.cells] = filled[self.cells] >= SURFACE_FILL
        divergence(u, n, filled, f["divergence"])
        compliance = 1.0 / self.stiffness
        right = -strain - dt * f["divergence"]
        p = f["pressure"]
        p *= active
        solve_pressure(
            p, right, filled, inverse_mass, active, compliance, dt, n, self.sweeps[0], self.least[0]
        )
        excess, neighbors = filled - 1.0, np.pad(active[self.cells], 1, constant_values=True)
        inside = np.ones(n, bool)
        for i in range(3):
            for j in range(3):
                inside &= neighbors[i : i + n[0], j : j + n[1]]
        gaps = np.zeros(filled.shape, bool)
        gaps[self.cells] = inside
        excess[~gaps] = np.maximum(excess[~gaps], 0.0)
        potential, moves = np.zeros_like(p), np.zeros_like(u)
        solve_pressure(
            potential, excess, filled, inverse_mass, active, 0.0, 1.0, n, self.sweeps[1],
            self.least[1],
        )  # fmt: skip
        push(potential, filled, inverse_mass, moves, n, 1.0)
        return moves

    def _keep_volume(self) -> None:
        """Give the particles their cells' pressure (implicit), or relax and shift them."""
        f, n = self.fields, self.n
        if self.implicit:
            strain = -f["pressure"] / self.stiffness
            reflect(strain, n, centers=True)
            take(strain, self.x, self.theta)
            return
        if self.steps % SHIFT_INTERVAL:
            return
        fill = f["filled"].copy()
        reflect(fill, n, centers=True)
        at_particles = np.zeros(len(self.x))
        take(fill, self.x, at_particles)
        low, high = RELAXED_FILLS
        self.theta *= np.clip((at_particles - low) / (high - low), 0.0, 1.0)
        whole = f["mass"].copy()  # nodes on walls stand for half a cell
        for k in range(2):
            rows = np.moveaxis(whole, k, 0)
            rows[[GHOSTS, GHOSTS + n[k]]] *= 2
        excess = np.zeros_like(whole)
        excess[self.nodes] = np.maximum(whole[self.nodes] - SHIFT_FILL, 0)
        reflect(excess, n)
        shift_particles(self.x, self.v, self.C, excess, n)
