"""Two sides of thin walls on dense arrays, in plain NumPy; see kernels.py.

Where walls are is computed in the blocks close to them, as for the other engines.
"""

from typing import Any

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import MovingColliders

from .kernels import SIDED_CELLS, SampledShells
from .plan import ThinWallsPlan


class WallSides:
    """Phases on the front and the back side of thin walls, and the walls at the nodes.

    Attributes:
        collider: Outward normal and distance of the nearest collider [m], shape (..., 4).
        whose, moves: Its number, shape (...), and its velocity, shape (..., 3) [m/s].
        faces: Normal and distance [m] of the wall for its two sides, shape (..., 2, 4).
    """

    def __init__(self, plan: ThinWallsPlan, movers: MovingColliders, dense: Any):
        """Take the sides of a plan."""
        self.movers, self.dense = movers, dense
        self.half = np.array(plan.side)
        # (front, back) phases
        self.pairs = [
            (twin, p) for p, twin in enumerate(plan.twin) if self.half[p] < 0 and twin >= 0
        ]
        self.collider, self.moves = np.zeros((*dense.shape, 4)), np.zeros((*dense.shape, 3))
        self.collider_number = np.zeros(dense.shape, np.int64)
        self.faces = np.zeros((*dense.shape, 2, 4))
        self.is_divided = np.zeros(dense.shape, bool)  # where the two sides are two fields
        self.merged_sides: list[tuple[int, int, np.ndarray]] = []  # front, back, where both are one

    def place(self) -> None:
        """Copy the colliders as they are in this step to dense arrays."""
        movers, table = self.movers, self.movers.table
        assert isinstance(table, SampledShells)
        inside, index = self.dense.nodes_of_blocks(movers.blocks)
        self.collider[..., 3] = self.faces[..., 3] = np.inf
        self.collider[index], self.moves[index] = movers.nodes[inside], movers.moves[inside]
        self.faces[index] = table.faces[inside]
        if len(movers.collider_number):
            self.collider_number[index] = movers.collider_number[inside]
        close = self.collider[..., 3] < SIDED_CELLS * self.dense.dx
        self.is_divided = close & (self.faces[..., 0, 3] < np.inf)

    def unite(self, v: np.ndarray, mass: np.ndarray, *sums: np.ndarray) -> None:
        """Move what is on back sides to front sides, where both sides are one.

        Args:
            v: Velocities (in/out), shape (phases, ..., 3) [m/s].
            mass: Masses (in/out), shape (phases, ...) [kg].
            sums: Other nodal sums (in/out), shape (phases, ..., n).
        """
        self.merged_sides = []
        for front, back in self.pairs:
            common = (mass[back] > 0.0) & ~self.is_divided
            v[front][common] = _mean(v, mass, front, back, common)
            v[back][common] = 0.0
            mass[front][common] += mass[back][common]
            mass[back][common] = 0.0
            for field in sums:
                field[front][common] += field[back][common]
            self.merged_sides.append((front, back, common))

    def part(self, v: np.ndarray) -> None:
        """Give back sides the common velocity where `unite` made both one."""
        for front, back, common in self.merged_sides:
            v[back][common] = v[front][common]

    def average(self, v: np.ndarray, mass: np.ndarray) -> None:
        """Give both sides their mean velocity where they are one.

        Args:
            v: Velocities (in/out), shape (phases, ..., 3) [m/s].
            mass: Masses, shape (phases, ...) [kg].
        """
        for front, back in self.pairs:
            common = (mass[back] > 0.0) & ~self.is_divided
            v[front][common] = v[back][common] = _mean(v, mass, front, back, common)

    def seen_from(self, side: int, filled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what fills the nodes, shape (..., 1), and their distance from walls [m].

        Args:
            side: 1 on the front side of walls, -1 on the back side, 0 on neither.
            filled: Part of the cells that each phase fills, shape (phases, ..., 1).
        """
        own = filled[self.half >= 0 if side >= 0 else self.half <= 0].sum(0)
        own = np.where(self.is_divided[..., None], own, filled.sum(0))
        face = self.faces[..., (1 - side) // 2, 3] if side else np.inf
        return own, np.where(self.is_divided, face, self.collider[..., 3])

    def are_apart(self, p: int, q: int, node: tuple) -> bool:
        """Return whether two phases lie on different sides of a wall, so that they do not meet.

        Args:
            p, q: The two phases.
            node: Index of the node.
        """
        return bool(self.half[p] * self.half[q] < 0 and self.is_divided[node])

    def face(self, p: int, node: tuple, normal: np.ndarray, distance: float):
        """Return normal and distance [m] of a collider as a phase meets it at a node.

        Args:
            p: Phase.
            node: Index of the node.
            normal, distance: Those of the closest face.
        """
        if self.half[p] == 0 or not self.is_divided[node]:
            return normal, distance
        own = self.faces[node][(1 - self.half[p]) // 2]
        return own[:3], own[3]


def _mean(v: np.ndarray, mass: np.ndarray, front: int, back: int, common: np.ndarray) -> np.ndarray:
    """Return the mean velocity of two phases at the nodes `common`."""
    m, n = mass[front][common][:, None], mass[back][common][:, None]
    return (m * v[front][common] + n * v[back][common]) / (m + n)
