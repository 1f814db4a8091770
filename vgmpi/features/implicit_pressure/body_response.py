"""Free rigid bodies in the system of the pressure: they answer to it within the same solution.

A body that floats moves with the liquid that it displaces: its velocity and the pressure are found
together, so that bodies of any density are stable. The preconditioner takes the bodies into the
sweeps of the finest level: with S the inverse diagonal of the liquid, B = J^T S J and W the inverse
of the bodies' inertia, which joints reduce,

    (S^-1 + J W J^T)^-1 = S - S J (1 + W B)^-1 W J^T S

References:
    Batty, Bertails, Bridson (2007): A fast variational framework for accurate solid-fluid coupling.
    ACM Trans. Graph. 26 (3), 100.
"""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import NodeState, PushedBodies
from vgmpi.kernels.kernel_arguments import Walls
from vgmpi.kernels.reproducible_sums import REMAINDER, next_power_of_two
from vgmpi.parallel.communicator import SerialCommunicator

from .kernels import body_rows
from .kernels.relaxation import LevelFields

UNIT_BITS = 20  # binary digits below the largest number of a field, for sums over cells
MATRIX_UNIT = 2.0**-10  # of the sums of J^T S J


def let_liquids_stick(
    bodies: PushedBodies, nodes: NodeState, dt: float, gravity: np.ndarray
) -> None:  # fmt: skip
    """Let liquids stick to free bodies: nodes and bodies that stick meet without rebound.

    With the nodes' masses A and momenta b, the bodies' velocities U without them and the inverse W
    of their inertia, V = U + W (b - A V). So it is stable for bodies of any mass. Collective.

    Args:
        bodies: The bodies.
        nodes: Nodes of the rank (velocities in/out).
        dt: Length of the step [s].
        gravity: Acceleration, shape (3,) [m/s2].
    """
    adhering = bodies.sum_adhesion(nodes, dt)
    if adhering is None:
        return
    matrix = adhering.matrix
    v = bodies.predict_velocities(dt, gravity).reshape(-1)
    condensed, product, change = np.zeros_like(matrix), np.zeros_like(v), np.zeros_like(v)
    body_rows.condense(bodies.mobility(), matrix, condensed)
    body_rows.multiply_vector(matrix, v, product)
    body_rows.multiply_vector(condensed, adhering.momentum - product, change)
    bodies.apply_adhesion(nodes, dt, adhering, (v + change).reshape(-1, 6))


class BodyResponse:
    """Free bodies of a run next to the cells with pressure of a rank."""

    def __init__(self, ranks: SerialCommunicator, mass_of_cell: float, dx: float):
        """Take the communicator, the mass of a full cell [kg] and the cell size [m]."""
        self.ranks, self.mass_of_cell, self.dx = ranks, mass_of_cell, dx
        self.rows, self.count, self.unit = body_rows.body_rows(512), 0, 1.0

    def find_rows(
        self, bodies: PushedBodies, system: Any, blocks: np.ndarray, walls: Walls, colliders: Any,
        fields: Any,
    ) -> None:  # fmt: skip
        """Find the cells in which the bodies move the liquid.

        Args:
            bodies: The bodies.
            system: System of the pressure with `lattice`, `level` and `counted`, a PressureSolver.
            blocks: Blocks of nodes near colliders and of the cells around them, shape (n,).
            walls: Walls of the domain.
            colliders: ColliderNodes.
            fields: PressureFields.
        """
        self.level: LevelFields = system.level
        centers = bodies.centers() / self.dx
        while True:
            self.count = body_rows.find_rows(
                blocks, system.lattice, walls, colliders, centers, fields, self.level.scale,
                self.rows,
            )  # fmt: skip
            if self.count <= len(self.rows.cell):
                break
            self.rows = body_rows.body_rows(2 * self.count)
        rows = slice(self.count)
        self.rows.counts[rows] = system.counted[self.rows.cell[rows]]

    def begin(self, bodies: PushedBodies, v: np.ndarray) -> None:
        """Take the bodies' inertia, and the divergence that they would make. Collective.

        Args:
            bodies: The bodies.
            v: Velocities that they would have without the pressure, shape (m, 6) [m/s], [rad/s].
        """
        scale = np.tile([1.0, 1.0, 1.0, self.dx, self.dx, self.dx], len(v))
        self.mobility = self.mass_of_cell * scale[:, None] * bodies.mobility() * scale
        own = v * np.array([1.0 / self.dx] * 3 + [1.0] * 3)
        body_rows.subtract_divergence(self.count, self.rows, own, self.level)
        self.take_cells()

    def take_cells(self) -> None:
        """Take the cells with pressure, for the sweeps. Collective."""
        n = len(self.mobility)
        sums = np.zeros((n, n, 2), np.int64)
        body_rows.sum_matrix(self.count, self.rows, self.level, 1.0 / MATRIX_UNIT, sums)
        self.matrix = self._total(sums, MATRIX_UNIT)
        self.condensed = np.zeros((n, n))
        body_rows.condense(self.mobility, self.matrix, self.condensed)

    def take_magnitude(self, magnitude: float) -> None:
        """Take the largest number, a power of two on all ranks, of which sums are taken next."""
        self.unit = magnitude * 2.0**-UNIT_BITS

    def find_magnitude(self, values: np.ndarray) -> None:
        """Take the largest of the numbers of all ranks, see `take_magnitude`. Collective."""
        own = np.array([float(np.abs(values).max(initial=0))])
        self.take_magnitude(float(next_power_of_two(float(self.ranks.max(own)[0]))))

    def begin_first_sweep(self) -> None:
        """Prepare for a sweep before which the correction is 0."""
        self.rows.before[: self.count] = 0.0

    def begin_sweep(self) -> None:
        """Note the correction before a sweep."""
        body_rows.note_correction(self.count, self.rows, self.level)

    def end_sweep(self, weight: float, inertia: float) -> None:
        """Add to a sweep what the bodies answer. Collective.

        Args:
            weight, inertia: Factors of the sweep.
        """
        sums = np.zeros((2, len(self.mobility), 2), np.int64)
        body_rows.sum_sweep(
            self.count, self.rows, weight, inertia, self.level, 1.0 / self.unit, sums
        )
        impulse, scaled = self._total(sums, self.unit)
        change = self._product(self.mobility, impulse)
        unanswered = scaled - self._product(self.matrix, change)
        change = (change + self._product(self.condensed, unanswered)).reshape(-1, 6)
        body_rows.correct_sweep(self.count, self.rows, weight, change, self.level)

    def add_product(self, potential: np.ndarray, product: np.ndarray) -> None:
        """Add what the bodies answer to a potential to its product with the system. Collective."""
        body_rows.add_product(self.count, self.rows, self._answer(potential), product)

    def correct_remainder(self, per_quantum: float) -> None:
        """Subtract what the bodies answer to the correction from the remainder. Collective."""
        change = self._answer(self.level.correction)
        body_rows.correct_remainder(self.count, self.rows, change, per_quantum, self.level)

    def find_impulses(self, phi: np.ndarray) -> np.ndarray:
        """Return impulses and their moments on the bodies, (m, 6) [kg m/s], [kg m2/s]. Collective.

        Args:
            phi: Potential, flat.
        """
        self.find_magnitude(phi)
        unit = self.mass_of_cell * self.dx
        return self._sum(phi).reshape(-1, 6) * np.array([unit] * 3 + [unit * self.dx] * 3)

    def _answer(self, potential: np.ndarray) -> np.ndarray:
        """Return the change of the bodies' velocities by a potential, shape (m, 6)."""
        return self._product(self.mobility, self._sum(potential)).reshape(-1, 6)

    def _sum(self, potential: np.ndarray) -> np.ndarray:
        """Return J^T of a potential, shape (6 m,)."""
        sums = np.zeros((len(self.mobility), 2), np.int64)
        body_rows.sum_potential(self.count, self.rows, potential, 1.0 / self.unit, sums)
        return self._total(sums, self.unit)

    def _total(self, sums: np.ndarray, unit: float) -> np.ndarray:
        """Return sums over all ranks, of units and remainders along the last axis."""
        total = self.ranks.sum(sums)
        return (total[..., 0] + total[..., 1] * REMAINDER) * unit

    def _product(self, matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
        out = np.zeros(len(vector))
        body_rows.multiply_vector(matrix, vector, out)
        return out
