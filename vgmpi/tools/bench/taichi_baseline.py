"""Rival: Taichi on the processor, in the pattern of its own MLS-MPM examples.

It has dense fields and a loop over the particles that adds to the grid atomically.
"""

import time

import numpy as np
import taichi as ti

from .dense_grid_baseline import CARD, Dense


class Contestant(Dense):
    """Taichi as a contestant."""

    versions = {"taichi": ".".join(map(str, ti.__version__))}
    clock = staticmethod(time.process_time)

    def build(self):
        """Allocate fields and compile the kernels."""
        ti.init(
            arch=ti.cuda if CARD else ti.cpu,
            cpu_max_num_threads=self.threads,
            default_fp=ti.f32,
            offline_cache=False,
            log_level=ti.ERROR,
        )
        n, cells = self.count, self.numbers["cells"]
        self.x = ti.Vector.field(3, ti.f32, n)
        self.v = ti.Vector.field(3, ti.f32, n)
        self.C = ti.Matrix.field(3, 3, ti.f32, n)
        self.F = ti.Matrix.field(3, 3, ti.f32, n)
        self.J = ti.field(ti.f32, n)
        self.grid_v = ti.Vector.field(3, ti.f32, (cells, cells, cells))
        self.grid_m = ti.field(ti.f32, (cells, cells, cells))
        self.kernels = _kernels(self.numbers, self)

    def load(self, x, v):
        """Load particles: positions [cells] and velocities [cells/s]."""
        self.x.from_numpy(x)
        self.v.from_numpy(v)
        self.C.fill(0)
        self.F.from_numpy(np.tile(np.eye(3, dtype=np.float32), (self.count, 1, 1)))
        self.J.fill(1)

    def step(self):
        """Advance one time step."""
        for kernel in self.kernels:
            kernel()

    def finish(self):
        """Wait until the device has computed all steps."""
        ti.sync()

    def state(self):
        """Return positions and velocities, shape (n, 3) each."""
        return self.x.to_numpy(), self.v.to_numpy()

    def grid_mass(self):
        """Return the total mass on the grid after P2G."""
        return float(self.grid_m.to_numpy().sum(dtype=np.float64))


def _kernels(numbers: dict, rival: Contestant) -> tuple:
    """Clear, particles to grid, grid, grid to particles."""
    grid_v, grid_m = rival.grid_v, rival.grid_m
    push = numbers["gravity"] * numbers["dt"]

    @ti.kernel
    def clear():
        """Set the grid to zero."""
        for node in ti.grouped(grid_m):
            grid_v[node] = ti.Vector([0.0, 0.0, 0.0])
            grid_m[node] = 0.0

    @ti.kernel
    def update():
        """Turn momentum into velocity at the nodes."""
        for node in ti.grouped(grid_m):
            if grid_m[node] > 0.0:
                grid_v[node] /= grid_m[node]
                grid_v[node].z += push

    return clear, _to_grid(numbers, rival), update, _from_grid(numbers, rival)


def _to_grid(numbers: dict, rival: Contestant):
    """The kernel that moves the state on and adds momentum and mass to the nodes."""
    x, v, C, F, J = rival.x, rival.v, rival.C, rival.F, rival.J
    grid_v, grid_m = rival.grid_v, rival.grid_m
    dx, dt, volume, mass = numbers["dx"], numbers["dt"], numbers["volume"], rival.mass
    is_fluid, law, inverse = numbers["law"] == "fluid", numbers["constants"], 1.0 / dx
    stiffness = law.get("k", 0.0)
    mu, lam = law.get("mu", 0.0), law.get("lam", 0.0)

    @ti.kernel
    def p2g():
        """Transfer mass, momentum and stress from particles to the grid."""
        for p in x:
            position = x[p] * inverse
            base = ti.cast(position - 0.5, ti.i32)
            fx = position - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            unit = ti.Matrix.identity(ti.f32, 3)
            tau = unit
            if ti.static(is_fluid):
                J[p] *= ti.exp(dt * (C[p].trace() - 0.5 * dt * (C[p] @ C[p]).trace()))
                tau = -stiffness * (1.0 / J[p] ** 7 - 1.0) * J[p] * unit
            else:
                F[p] = (unit + dt * C[p]) @ F[p]
                tau = (
                    mu * (F[p] @ F[p].transpose() - unit) + lam * ti.log(F[p].determinant()) * unit
                )
            affine = mass * C[p] - (dt * volume * 4.0 * inverse * inverse) * tau
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                weight = w[i].x * w[j].y * w[k].z
                grid_v[base + offset] += weight * (mass * v[p] + affine @ ((offset - fx) * dx))
                grid_m[base + offset] += weight * mass

    return p2g


def _from_grid(numbers: dict, rival: Contestant):
    """The kernel that takes velocities from the nodes and moves the particles."""
    x, v, C, grid_v = rival.x, rival.v, rival.C, rival.grid_v
    dt, inverse = numbers["dt"], 1.0 / numbers["dx"]

    @ti.kernel
    def g2p():
        """Gather velocities, update deformation and move the particles."""
        for p in x:
            position = x[p] * inverse
            base = ti.cast(position - 0.5, ti.i32)
            fx = position - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector.zero(ti.f32, 3)
            new_C = ti.Matrix.zero(ti.f32, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                weighted = w[i].x * w[j].y * w[k].z * grid_v[base + offset]
                new_v += weighted
                new_C += weighted.outer_product(offset - fx)
            v[p] = new_v
            C[p] = 4.0 * inverse * new_C
            x[p] += dt * new_v

    return g2p
