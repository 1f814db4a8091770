"""Rival: Warp on the processor, where it has one thread.

The kernels follow the pattern of its MPM solvers: a launch over the particles that adds to a dense
grid atomically.
"""

import time

import numpy as np
import warp as wp

from .dense_grid_baseline import CARD, Dense

DEVICE = "cuda" if CARD else "cpu"
wp.config.quiet = True
wp.config.enable_backward = False  # no code for gradients: half the time to compile


@wp.struct
class Numbers:
    """Constants of the scene, as Warp sees them."""

    is_fluid: int
    first: float  # k or mu
    second: float  # - or lam
    dx: float
    dt: float
    volume: float
    mass: float


@wp.func
def weights(fx: wp.vec3):
    """Return the quadratic B-spline weights of an offset to the base node."""
    a = wp.vec3(1.5) - fx
    b = fx - wp.vec3(1.0)
    c = fx - wp.vec3(0.5)
    return wp.matrix_from_cols(
        wp.cw_mul(a, a) * 0.5, wp.vec3(0.75) - wp.cw_mul(b, b), wp.cw_mul(c, c) * 0.5
    )


@wp.kernel
def p2g(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    F: wp.array(dtype=wp.mat33),
    J: wp.array(dtype=float),
    grid_v: wp.array3d(dtype=wp.vec3),
    grid_m: wp.array3d(dtype=float),
    numbers: Numbers,
):
    """Transfer mass, momentum and stress from particles to the grid."""
    p = wp.tid()
    dx, dt, mass = numbers.dx, numbers.dt, numbers.mass
    first, second = numbers.first, numbers.second
    inverse = 1.0 / dx
    position = x[p] * inverse
    bx = int(position[0] - 0.5)
    by = int(position[1] - 0.5)
    bz = int(position[2] - 0.5)
    fx = position - wp.vec3(float(bx), float(by), float(bz))
    unit = wp.identity(n=3, dtype=float)
    tau = wp.mat33()
    if numbers.is_fluid == 1:
        j = J[p] * wp.exp(dt * (wp.trace(C[p]) - 0.5 * dt * wp.trace(C[p] * C[p])))
        J[p] = j
        cube = j * j * j
        tau = unit * (-first * (1.0 / (cube * cube * j) - 1.0) * j)
    else:
        f = (unit + C[p] * dt) * F[p]
        F[p] = f
        tau = (f * wp.transpose(f) - unit) * first + unit * (second * wp.log(wp.determinant(f)))
    affine = C[p] * mass - tau * (dt * numbers.volume * 4.0 * inverse * inverse)
    w = weights(fx)
    momentum = v[p] * mass
    for i in range(3):
        for j in range(3):
            for k in range(3):
                d = (wp.vec3(float(i), float(j), float(k)) - fx) * dx
                weight = w[0, i] * w[1, j] * w[2, k]
                wp.atomic_add(grid_v, bx + i, by + j, bz + k, (momentum + affine * d) * weight)
                wp.atomic_add(grid_m, bx + i, by + j, bz + k, mass * weight)


@wp.kernel
def update(grid_v: wp.array3d(dtype=wp.vec3), grid_m: wp.array3d(dtype=float), push: float):
    """Turn momentum into velocity at the nodes."""
    i, j, k = wp.tid()
    m = grid_m[i, j, k]
    if m > 0.0:
        grid_v[i, j, k] = grid_v[i, j, k] * (1.0 / m) + wp.vec3(0.0, 0.0, push)


@wp.kernel
def g2p(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    grid_v: wp.array3d(dtype=wp.vec3),
    dx: float,
    dt: float,
):
    """Gather velocities, update deformation and move the particles."""
    p = wp.tid()
    inverse = 1.0 / dx
    position = x[p] * inverse
    bx = int(position[0] - 0.5)
    by = int(position[1] - 0.5)
    bz = int(position[2] - 0.5)
    fx = position - wp.vec3(float(bx), float(by), float(bz))
    w = weights(fx)
    new_v = wp.vec3()
    new_C = wp.mat33()
    for i in range(3):
        for j in range(3):
            for k in range(3):
                weighted = grid_v[bx + i, by + j, bz + k] * (w[0, i] * w[1, j] * w[2, k])
                new_v = new_v + weighted
                new_C = new_C + wp.outer(weighted, wp.vec3(float(i), float(j), float(k)) - fx)
    v[p] = new_v
    C[p] = new_C * (4.0 * inverse)
    x[p] = x[p] + new_v * dt


class Contestant(Dense):
    """Warp as a contestant."""

    versions = {"warp": wp.__version__}
    clock = staticmethod(time.process_time)

    def build(self):
        """Allocate fields and compile the kernels."""
        wp.init()
        n, cells = self.count, self.numbers["cells"]
        self.C = wp.zeros(n, dtype=wp.mat33, device=DEVICE)
        self.J = wp.zeros(n, dtype=float, device=DEVICE)
        grid = (cells, cells, cells)
        self.grid_v = wp.zeros(grid, dtype=wp.vec3, device=DEVICE)
        self.grid_m = wp.zeros(grid, dtype=float, device=DEVICE)
        law = self.numbers["constants"]
        constants = self.constants = Numbers()
        constants.is_fluid = int(self.numbers["law"] == "fluid")
        pair = (law["k"], 0.0) if constants.is_fluid else (law["mu"], law["lam"])
        constants.first, constants.second, constants.mass = *pair, self.mass
        constants.dx, constants.dt, constants.volume = (
            self.numbers[key] for key in ("dx", "dt", "volume")
        )

    def load(self, x, v):
        """Load particles: positions [cells] and velocities [cells/s]."""
        identity = np.tile(np.eye(3, dtype=np.float32), (self.count, 1, 1))
        self.x = wp.array(x, dtype=wp.vec3, device=DEVICE)
        self.v = wp.array(v, dtype=wp.vec3, device=DEVICE)
        self.F = wp.array(identity, dtype=wp.mat33, device=DEVICE)
        self.C.zero_()
        self.J.fill_(1.0)

    def step(self):
        """Advance one time step."""
        dx, dt = self.numbers["dx"], self.numbers["dt"]
        self.grid_v.zero_()
        self.grid_m.zero_()
        state = [self.x, self.v, self.C, self.F, self.J, self.grid_v, self.grid_m]
        push = self.numbers["gravity"] * dt
        wp.launch(p2g, self.count, [*state, self.constants], device=DEVICE)
        wp.launch(update, self.grid_m.shape, [self.grid_v, self.grid_m, push], device=DEVICE)
        wp.launch(g2p, self.count, [self.x, self.v, self.C, self.grid_v, dx, dt], device=DEVICE)

    def finish(self):
        """Wait until the device has computed all steps."""
        wp.synchronize()

    def state(self):
        """Return positions and velocities, shape (n, 3) each."""
        return self.x.numpy(), self.v.numpy()

    def grid_mass(self):
        """Return the total mass on the grid after P2G."""
        return float(self.grid_m.numpy().sum(dtype=np.float64))
