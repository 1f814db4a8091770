"""Moving colliders at nodes, in plain numpy: see domain/sampled.py."""

import numpy as np

from ...domain.sampled import Sampled


def place(
    table: Sampled, points: np.ndarray, dt: float, dx: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward normal and distance [m] (n, 4) of the nearest collider at points (n, 3) [m], its
    number (n,), and the mean velocity [m/s] (n, 3) of its surface there in a step of dt [s]."""
    nodes, moves = np.zeros((len(points), 4)), np.zeros((len(points), 3))
    whose = np.zeros(len(points), np.int64)
    nodes[:, 3] = np.inf
    for m in range(len(table.first)):
        about, R = table.about[m], table.rotation[m]
        own = (points - about - table.move[m]) @ R + about
        inside, distance, gradient = sample(table, m, own)
        size = np.linalg.norm(gradient, axis=1)
        chosen = (distance < nodes[inside, 3]) & (size > 0)
        near = np.flatnonzero(inside)[chosen]
        normal = (gradient[chosen] / size[chosen, None]) @ R.T
        nodes[near] = np.column_stack([normal, distance[chosen]])
        surface = points[near] - np.clip(distance[chosen], -2 * dx, 2 * dx)[:, None] * normal
        body = (surface - about - table.move[m]) @ R
        end = body @ table.rotation_end[m].T + about + table.move_end[m]
        moves[near], whose[near] = (end - surface) / dt, m
    return nodes, whose, moves


def sample(table: Sampled, m: int, own: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points (n, 3) of a body lie on its lattice (n,) bool, and of these the distance [m] and
    its gradient (k, 3), linear in between."""
    s = (own - table.start[m]) / table.spacing
    corner = np.floor(s).astype(np.int64)
    inside = ((corner >= 0) & (corner <= table.shape[m] - 2)).all(axis=1)
    corner, s = corner[inside], s[inside] - corner[inside]
    grid = table.values[table.first[m] :][: np.prod(table.shape[m])].reshape(table.shape[m])
    distance, gradient = np.zeros(len(s)), np.zeros((len(s), 3))
    for step in np.ndindex(2, 2, 2):
        value = grid[tuple((corner + step).T)]
        w = np.where(step, s, 1 - s)  # (k, 3)
        distance += value * w.prod(axis=1)
        for a in range(3):
            others = np.delete(w, a, axis=1).prod(axis=1)
            gradient[:, a] += (1 if step[a] else -1) * value * others / table.spacing
    return inside, distance, gradient
