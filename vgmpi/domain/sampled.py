"""Moving colliders at the nodes of blocks: distance, outward normal and velocity.

Each is known by its signed distance on a lattice of its own frame, linear in between: exact for
faces, wherever they turn to, and rounder at edges than the shape by a quarter of a cell.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline, kernel
from .solids import REACH


class Sampled(NamedTuple):
    """m rigid colliders. rotation, move: x = rotation (x0 - about) + about + move of their points
    at x0 at the start, at the beginning of a step; rotation_end, move_end: at its end."""

    values: np.ndarray  # (n,) signed distances [m], of all lattices
    first: np.ndarray  # (m,) where each begins
    shape: np.ndarray  # (m, 3)
    start: np.ndarray  # (m, 3) first point of each [m]
    spacing: float  # [m]
    about: np.ndarray  # (m, 3) [m]
    rotation: np.ndarray  # (m, 3, 3)
    move: np.ndarray  # (m, 3) [m]
    rotation_end: np.ndarray
    move_end: np.ndarray


@inline
def _own(movers, m, x, own):
    """The point of the body, at the start, that is at x (3,) now: into own (3,)."""
    r = movers.rotation[m]
    a = x[0] - movers.about[m, 0] - movers.move[m, 0]
    b = x[1] - movers.about[m, 1] - movers.move[m, 1]
    c = x[2] - movers.about[m, 2] - movers.move[m, 2]
    for k in range(3):
        own[k] = r[0, k] * a + r[1, k] * b + r[2, k] * c + movers.about[m, k]


@inline
def _sample(movers, m, own, found):
    """Distance [m] and its gradient at a point of the body: into found (4,), gradient first; False
    outside the lattice."""
    nx, ny, nz = movers.shape[m, 0], movers.shape[m, 1], movers.shape[m, 2]
    x = (own[0] - movers.start[m, 0]) / movers.spacing
    y = (own[1] - movers.start[m, 1]) / movers.spacing
    z = (own[2] - movers.start[m, 2]) / movers.spacing
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    if i < 0 or j < 0 or k < 0 or i > nx - 2 or j > ny - 2 or k > nz - 2:
        return False
    x, y, z = x - i, y - j, z - k
    at = movers.first[m] + (i * ny + j) * nz + k
    v, up, over = movers.values, nz, ny * nz
    a, b, c, d = v[at], v[at + 1], v[at + up], v[at + up + 1]
    e, f, g, h = v[at + over], v[at + over + 1], v[at + over + up], v[at + over + up + 1]
    low, high = a + z * (b - a), c + z * (d - c)
    low2, high2 = e + z * (f - e), g + z * (h - g)
    near, far = low + y * (high - low), low2 + y * (high2 - low2)
    found[0] = (far - near) / movers.spacing
    found[1] = ((high - low) * (1 - x) + (high2 - low2) * x) / movers.spacing
    along, along2 = (b - a) * (1 - y) + (d - c) * y, (f - e) * (1 - y) + (h - g) * y
    found[2] = (along * (1 - x) + along2 * x) / movers.spacing
    found[3] = near + x * (far - near)
    return True


@inline
def _carry(movers, m, own, x, dt, velocity):
    """Mean velocity [m/s] over a step of dt [s] of the body's point that is at x now."""
    r = movers.rotation_end[m]
    a = own[0] - movers.about[m, 0]
    b = own[1] - movers.about[m, 1]
    c = own[2] - movers.about[m, 2]
    for k in range(3):
        end = r[k, 0] * a + r[k, 1] * b + r[k, 2] * c + movers.about[m, k] + movers.move_end[m, k]
        velocity[k] = (end - x[k]) / dt


@kernel
def place(blocks, first, near, movers, dt, dx, nodes, moves, whose):
    """The nearest collider at the nodes of blocks (n, 3), of those that are near a block:
    near[first[b] : first[b + 1]]. Outward normal and distance [m] into nodes (n, 64, 4), where none
    is near an infinite one; into moves (n, 64, 3) the mean velocity [m/s] in a step of dt [s] of
    its surface nearest to the node; into whose (n, 64) its number, or (0, 64)."""
    x, own, found, velocity = np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(3)
    normal, surface = np.zeros(3), np.zeros(3)
    for b in range(len(blocks)):
        for node in range(64):
            nodes[b, node, 3] = np.inf
        for m in near[first[b] : first[b + 1]]:
            for node in range(64):
                x[0] = (4 * blocks[b, 0] - 1 + node // 16) * dx
                x[1] = (4 * blocks[b, 1] - 1 + node // 4 % 4) * dx
                x[2] = (4 * blocks[b, 2] - 1 + node % 4) * dx
                _own(movers, m, x, own)
                if not _sample(movers, m, own, found):
                    continue
                if found[3] >= min(nodes[b, node, 3], REACH * dx):
                    continue
                size = np.sqrt(found[0] ** 2 + found[1] ** 2 + found[2] ** 2)
                if size == 0.0:
                    continue
                r, d = movers.rotation[m], found[3]
                for k in range(3):
                    normal[k] = (
                        r[k, 0] * found[0] + r[k, 1] * found[1] + r[k, 2] * found[2]
                    ) / size
                    nodes[b, node, k] = normal[k]
                nodes[b, node, 3] = d
                if len(whose) > 0:
                    whose[b, node] = m
                depth = min(max(d, -2.0 * dx), 2.0 * dx)
                for k in range(3):
                    surface[k] = x[k] - depth * normal[k]
                _own(movers, m, surface, own)
                _carry(movers, m, own, surface, dt, velocity)
                for k in range(3):
                    moves[b, node, k] = velocity[k]
