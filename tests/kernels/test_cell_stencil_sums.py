"""Dilatation by the means of cells against its definition, written out by cells."""

import numpy as np
import pytest
from numba import njit

from vgmpi.kernels import cell_stencil_sums, stencil_sums
from vgmpi.kernels.particle_records import PATCH, PLANE, ROW, splines

REAL = {"single": np.float32, "double": np.float64}
SIDE = 8


@njit
def gather(count, records, weights, base, patch):
    cell_stencil_sums.gather_cell_slopes(count, records, weights, base, patch)


@njit
def scatter(count, records, weights, base, patch):
    cell_stencil_sums.scatter_cell_pressure(count, records, weights, base, patch)


def particles(count, real, seed=1):
    """Base nodes (n, 3), fractions (n, 3), base rows and records of weights."""
    random = np.random.default_rng(seed)
    corner, inside = random.integers(0, 6, (count, 3)), random.uniform(0, 1, (count, 3))
    inside[0], inside[1] = 0.0, 0.5
    inside = inside.astype(real).astype(np.float64)
    weights = np.zeros((count, 16), real)
    x, y, z = (np.stack(splines(inside[:, a]), 1) for a in range(3))
    weights[:, :4], weights[:, 4:8], weights[:, 8:11], weights[:, 12] = x, y, z[:, :3], z[:, 3]
    base = (corner @ [PLANE, ROW, 4]).astype(np.int32)
    return corner, inside, base, weights.reshape(-1)


def mean_divergence(nodes, corner, inside):
    """The definition: mean divergence of each of the eight cells by its corners, interpolated."""
    found = []
    for (i, j, k), fraction in zip(corner, inside, strict=True):
        total = 0.0
        for cell in np.ndindex(2, 2, 2):
            a, b, c = np.array((i, j, k)) + cell
            v = nodes[a : a + 2, b : b + 2, c : c + 2, :3]
            rates = [np.diff(v[..., axis].mean(tuple({0, 1, 2} - {axis})))[0] for axis in range(3)]
            total += np.prod(np.where(cell, fraction, 1.0 - fraction)) * sum(rates)
        found.append(total)
    return np.array(found)


def divergence(records):
    return records[0::16] + records[5::16] + records[10::16]


@pytest.mark.parametrize("precision, within", [("single", 2e-5), ("double", 1e-13)])
def test_a_divergence_is_the_mean_of_cells(precision, within):
    real = REAL[precision]
    corner, inside, base, weights = particles(60, real)
    patch = np.random.default_rng(2).normal(0, 1, PATCH + 16).astype(real)
    nodes = patch[:PATCH].reshape(SIDE, SIDE, SIDE, 4).astype(np.float64)
    records = np.zeros(60 * 16, real)
    gather(60, records, weights, base, patch)
    assert np.abs(divergence(records) - mean_divergence(nodes, corner, inside)).max() < within


@pytest.mark.parametrize("precision, within", [("single", 2e-4), ("double", 1e-12)])
def test_pressure_is_its_adjoint_and_pushes_nothing_as_a_whole(precision, within):
    """Power of the forces on any velocities: pressure times dilatation; their sum: 0."""
    real, random = REAL[precision], np.random.default_rng(3)
    _, _, base, weights = particles(60, real)
    velocity, pressure = random.normal(0, 1, PATCH + 16).astype(real), random.normal(0, 1, 60)
    pressure = pressure.astype(real)
    records, forces = np.zeros((60, 16), real), np.zeros(PATCH + 16, real)
    records[:, [4, 9, 14]] = pressure[:, None]
    scatter(60, records.reshape(-1), weights, base, forces)
    power = (forces[:PATCH].astype(np.float64) * velocity[:PATCH]).sum()
    gathered = np.zeros(60 * 16, real)
    gather(60, gathered, weights, base, velocity)
    assert abs(power - (pressure * divergence(gathered)).sum()) < within
    assert np.abs(forces[:PATCH].reshape(-1, 4).sum(0, dtype=np.float64)).max() < within
    assert np.abs(forces).max() > 0.1


def test_both_are_stencil_functions():
    assert {"gather_cell_slopes", "scatter_cell_pressure"} < stencil_sums.STENCIL_FUNCTIONS.keys()
