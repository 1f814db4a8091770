"""Sums over the particles of each segment, for the conservation monitor."""

import numpy as np

from vgmpi.kernels.simd.material_dispatch import energy, load_state_scalar, volume_ratio
from vgmpi.runtime.jit import kernel

from .particle_records import AFFINE, STATE, VOLUME

CELL_UNITS = 1 << 32  # units of the volume of a cell in which rest volumes are summed
COLUMNS = 12  # mass, momentum 3, angular momentum 3, kinetic, elastic, potential, J min, J max


@kernel
def segment_conservation_rows(law, start, count, block, xi, f, bits, density, dx, gravity, rows):
    """Compute mass, momentum, angular momentum, energies and J of each segment.

    Angular momentum is about the origin and includes the affine part that APIC carries. Particles
    are added in their order in the segment, so a row does not depend on the number of ranks.

    Args:
        law: Material parameters of the group.
        start, count: First particle and number of particles of each segment.
        block: Block coordinates, shape (segments, 3).
        xi: Fixed-point positions, shape (3, cap), in units of 2^-bits cells.
        f: Particle channels, shape (channels, cap).
        bits: Binary digits of a position within a cell.
        density: Rest density [kg/m3].
        dx: Cell size [m].
        gravity: Acceleration of gravity, shape (3,) [m/s2].
        rows: Sums (out), shape (segments, 12) float64, see `COLUMNS`.
    """
    inertia = dx * dx / 4.0  # second moment of a quadratic B-spline
    x = np.zeros(3)
    for s in range(len(start)):
        row = rows[s]
        row[:] = 0.0
        row[10], row[11] = np.inf, -np.inf
        for p in range(start[s], start[s] + count[s]):
            volume = float(f[VOLUME, p])
            m = density * volume
            for a in range(3):
                x[a] = (float(xi[a, p]) * 2.0**-bits + 4 * block[s, a] + 1.5) * dx
            v0, v1, v2 = float(f[0, p]), float(f[1, p]), float(f[2, p])
            row[0] += m
            row[1] += m * v0
            row[2] += m * v1
            row[3] += m * v2
            spin = m * inertia
            row[4] += m * (x[1] * v2 - x[2] * v1) + spin * (
                float(f[AFFINE + 7, p]) - float(f[AFFINE + 5, p])
            )
            row[5] += m * (x[2] * v0 - x[0] * v2) + spin * (
                float(f[AFFINE + 2, p]) - float(f[AFFINE + 6, p])
            )
            row[6] += m * (x[0] * v1 - x[1] * v0) + spin * (
                float(f[AFFINE + 3, p]) - float(f[AFFINE + 1, p])
            )
            square = v0 * v0 + v1 * v1 + v2 * v2
            for c in range(9):
                square += inertia * float(f[AFFINE + c, p]) ** 2
            row[7] += 0.5 * m * square
            state = load_state_scalar(law, f, STATE, p)
            row[8] += volume * energy(law, state)
            row[9] -= m * (gravity[0] * x[0] + gravity[1] * x[1] + gravity[2] * x[2])
            J = float(volume_ratio(law, state))
            row[10] = min(row[10], J)
            row[11] = max(row[11], J)


@kernel
def deposit_rest_volume(start, count, block, table, xi, f, bits, dx, cells, sums):
    """Add the rest volumes of particles to the nodes, by quadratic B-splines.

    What lies beyond a wall of the domain is reflected into it. Sums are integers, in units of
    1 / CELL_UNITS of a cell.

    Args:
        start, count: First particle and number of particles of each segment.
        block: Block coordinates, shape (segments, 3).
        table: Node blocks around each segment, shape (segments, 27).
        xi: Fixed-point positions, shape (3, cap), in units of 2^-bits cells.
        f: Particle channels, shape (channels, cap).
        bits: Binary digits of a position within a cell.
        dx: Cell size [m].
        cells: Cells of the domain, shape (3,).
        sums: Sums (in/out), shape (node blocks, 64) int64.
    """
    w, place = np.zeros((3, 3)), np.zeros((3, 3), np.int64)
    for s in range(len(start)):
        for p in range(start[s], start[s] + count[s]):
            units = float(f[VOLUME, p]) / dx**3 * CELL_UNITS
            for a in range(3):
                x = float(xi[a, p]) * 2.0**-bits + 4 * block[s, a] + 1.5
                base = np.int64(np.floor(x - 0.5))
                r = x - base
                w[a, 0] = 0.5 * (1.5 - r) ** 2
                w[a, 1] = 0.75 - (r - 1.0) ** 2
                w[a, 2] = 0.5 * (r - 0.5) ** 2
                for k in range(3):
                    node = abs(base + k)
                    node = min(node, 2 * cells[a] - node)
                    place[a, k] = node - 4 * block[s, a] + 5  # 0: first node of the block before
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        u, v, t = place[0, i], place[1, j], place[2, k]
                        row = table[s, (u // 4 * 3 + v // 4) * 3 + t // 4]
                        node = (u % 4 * 4 + v % 4) * 4 + t % 4
                        sums[row, node] += np.int64(np.rint(w[0, i] * w[1, j] * w[2, k] * units))


@kernel
def body_momentum_rows(start, count, block, xi, f, ids, bits, density, dx, first, last, rows):
    """Compute mass, momentum and first moment of the particles of a body, by segment.

    Args:
        start, count: First particle and number of particles of each segment.
        block: Block coordinates, shape (segments, 3).
        xi: Fixed-point positions, shape (3, cap), in units of 2^-bits cells.
        f: Particle channels, shape (channels, cap).
        ids: Particle ids, shape (cap,).
        bits: Binary digits of a position within a cell.
        density: Rest density [kg/m3].
        dx: Cell size [m].
        first, last: Range of ids of the body, both included.
        rows: Mass [kg], momentum [kg m/s] and mass times position [kg m] (out), shape (segments, 7)
            float64, summed in the order of the particles.
    """
    for s in range(len(start)):
        row = rows[s]
        row[:] = 0.0
        for p in range(start[s], start[s] + count[s]):
            if ids[p] < first or ids[p] > last:
                continue
            m = density * float(f[VOLUME, p])
            row[0] += m
            for a in range(3):
                row[1 + a] += m * float(f[a, p])
                row[4 + a] += m * (float(xi[a, p]) * 2.0**-bits + 4 * block[s, a] + 1.5) * dx
