"""The system of an implicit viscosity at the nodes, against a dense one in NumPy."""

import numpy as np

from tests.physics.test_implicit_pressure import nodal_grid
from tests.support.simulate import begin
from vgmpi.features.implicit_viscosity import coupling

SCENE = """
[domain]
size = [0.12, 0.1, 0.1]
cell = 0.02
gravity = [0, 0, 0]
boundary = { default = "slip", bottom = "stick", east = "separate" }
[time]
end = 0.1
[accuracy]
pressure = "explicit"
precision = "double"
viscosity = "implicit"
[material.honey]
kind = "fluid"
viscosity = 100
[[object]]
name = "pool"
material = "honey"
shape = { box = [[0, 0, 0], [0.12, 0.1, 0.052]] }
"""
DT, DX, NU = 2e-3, 0.02, 0.1


def element():
    """Stiffness (8, 3, 8, 3) of a cell of edge 1 for the stress 2 dev D, by Gauss points."""
    deviator = np.diag([2.0, 2, 2, 1, 1, 1])
    deviator[:3, :3] -= 2 / 3
    result, root = np.zeros((24, 24)), 0.5 / np.sqrt(3)
    for point in np.ndindex(2, 2, 2):
        at = 0.5 + root * (2 * np.array(point) - 1)
        strain = np.zeros((6, 8, 3))
        for n, corner in enumerate(np.ndindex(2, 2, 2)):
            hats, slopes = np.where(corner, at, 1 - at), 2.0 * np.array(corner) - 1
            gx, gy, gz = (
                slopes[a] * np.prod([hats[b] for b in range(3) if b != a]) for a in range(3)
            )
            strain[0, n, 0], strain[1, n, 1], strain[2, n, 2] = gx, gy, gz
            strain[3, n, :2], strain[4, n, ::2], strain[5, n, 1:] = (gy, gx), (gz, gx), (gz, gy)
        rows = strain.reshape(6, 24)
        result += rows.T @ deviator @ rows / 8
    return result.reshape(8, 3, 8, 3)


def dense_solution(velocity, mass):
    """Velocities (nodes, 3) of the scene after a step, and the nodes that respond.

    Args:
        velocity: Nodal velocities before, shape (nx, ny, nz, 3).
        mass: Nodal masses of the liquid relative to a full cell, shape (nx, ny, nz).
    """
    images, free = np.ones(mass.shape), np.repeat(mass[..., None] > 1e-9, 3, 3)
    for axis in range(3):
        for side in (0, -1):
            place = np.moveaxis(images, axis, 0)[side], np.moveaxis(free, axis, 0)[side]
            if (axis, side) == (0, -1):  # separate: it stops what moves into it
                place[1][..., 0] &= np.moveaxis(velocity, axis, 0)[side][..., 0] < 0
                continue
            place[0][...] *= 2
            place[1][..., axis] = False
    free[:, :, 0] = False  # the floor
    fill, size = images * mass, mass.size
    matrix = np.zeros((size, 3, size, 3))
    number = np.arange(size).reshape(mass.shape)
    for cell in np.ndindex(*(n - 1 for n in mass.shape)):
        part = tuple(slice(k, k + 2) for k in cell)
        share = min(1.0, fill[part].min() / coupling.FULL)
        nodes = number[part].reshape(-1)
        for a, p in enumerate(nodes):
            for b, q in enumerate(nodes):
                matrix[p, :, q] += share * ELEMENT[a, :, b]
    matrix = matrix.reshape(3 * size, 3 * size) * NU * DT / DX**2
    weights, rows = np.repeat(mass.reshape(-1), 3), np.flatnonzero(free)
    v = velocity.reshape(-1).copy()
    system = np.diag(weights) + matrix
    fixed = np.setdiff1d(np.arange(3 * size), rows)
    right = weights[rows] * v[rows] - matrix[np.ix_(rows, fixed)] @ v[fixed]
    v[rows] = np.linalg.solve(system[np.ix_(rows, rows)], right)
    return v.reshape(velocity.shape), free


ELEMENT = element()


def test_sweeps_converge_to_the_dense_solution(tmp_path, monkeypatch):
    def stirred(x):
        return np.random.default_rng(1).normal(0, 0.1, x.shape)

    monkeypatch.setattr(coupling, "MAX_ERROR", 1e-16)
    simulation, _ = begin(tmp_path, SCENE, velocity=stirred)
    grids, couple = [], coupling.ImplicitViscosity.couple_nodes

    def record(self, nodes, span, gravity):
        for act in (lambda: None, lambda: couple(self, nodes, span, gravity)):
            act()
            own = nodes.velocities[: len(nodes.tables.coordinates)].reshape(-1, 64, 4)
            grids.append(nodal_grid(simulation, own, 4))

    monkeypatch.setattr(coupling.ImplicitViscosity, "couple_nodes", record)
    simulation.advance(DT)
    before, after = grids
    wanted, free = dense_solution(before[..., :3], before[..., 3] / (1000 * DX**3))
    assert free.sum() > 200
    assert np.abs(wanted - before[..., :3])[free].max() > 0.03
    # what a separate wall would pull back stops there
    stopped = wanted[-1, ..., 0] > 0
    wanted[-1, ..., 0][stopped & free[-1, ..., 0]] = 0
    assert np.abs(after[..., :3] - wanted)[free].max() < 1e-9
    held = ~free
    assert np.array_equal(after[..., :3][held], before[..., :3][held])


def test_the_bound_of_the_eigenvalues():
    """Of M^-1 K with cells as full as their emptiest node: eight cells around a node."""
    stiffness = ELEMENT.reshape(24, 24)
    assert 8 * np.linalg.eigvalsh(stiffness)[-1] <= coupling.MAX_EIGENVALUE * (1 + 1e-12)


def test_sweeps_leave_less_than_a_hundredth():
    """The polynomial of the sweeps in the range of eigenvalues, for a flow across 16 cells.

    It decays by nu dt / dx2 (pi / 16)^2 in a step, and is that much smaller than the change.
    """
    for diffusion in (0.01, 0.5, 1.0, 30.0, 3000.0):
        highest = 1 + coupling.MAX_EIGENVALUE / coupling.FULL * diffusion
        x = np.linspace(1, highest, 1000)
        error, step = np.ones_like(x), np.zeros_like(x)
        for weight, inertia in coupling.sweep_factors(diffusion):
            step = -weight * x * error + inertia * step
            error = error + step
        assert np.abs(error).max() < 0.01 / (1 + diffusion * (np.pi / 16) ** 2)
