"""Moving colliders at the nodes of blocks: distance, outward normal and velocity.

The signed distance of each collider is sampled on a lattice in its own frame and interpolated
linearly. This is exact for plane faces in any orientation; edges are rounded by a quarter of a
cell. The normals at nodes are interpolated, too, from central differences: the gradient of the
linear distance jumps from one cell of the lattice to the next, and these steps of a round body that
turns would stir the flow around it.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.static_dispatch import static_dispatch
from vgmpi.runtime.jit import always_inline, array_function, device_function, kernel

from .static_colliders import SDF_BAND_CELLS


class SampledSdf(NamedTuple):
    """Sampled signed distances and poses of m rigid colliders.

    A point at x0 at the start is at x = rotation (x0 - about) + about + move at the beginning of a
    step, and likewise with rotation_end and move_end at its end.
    """

    values: np.ndarray  # (n,) [m] signed distances on all lattices
    first: np.ndarray  # (m,) row at which each lattice begins
    shape: np.ndarray  # (m, 3) points of each lattice along the axes
    start: np.ndarray  # (m, 3) [m] first point of each lattice
    spacing: float  # [m]
    about: np.ndarray  # (m, 3) [m] center of rotation
    rotation: np.ndarray  # (m, 3, 3)
    move: np.ndarray  # (m, 3) [m]
    rotation_end: np.ndarray  # (m, 3, 3)
    move_end: np.ndarray  # (m, 3) [m]

    def with_blocks(self, count: int) -> "SampledSdf":
        """Return the table with room for the nodes of some blocks near colliders."""
        return self


@static_dispatch
def sample_side(movers, m, own, sample):
    """Return the side of a thin wall on which a point is, 1 (front) or -1 (back), 0 without a wall.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        own: Point in the collider's frame, shape (3,) [m].
        sample: Gradient and distance [m] of its closest face (in/out), shape (4,).
    """


@sample_side.register(SampledSdf)
def _no_side(movers, m, own, sample):
    return 0


@static_dispatch
def store_side(movers, m, b, node, side):
    """Store the two faces of the wall that `sample_side` saw for a node of a block.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        b, node: Block and number of the node in it.
        side: What `sample_side` returned.
    """


@store_side.register(SampledSdf)
def _store_no_side(movers, m, b, node, side):
    pass


@device_function
def set_node_indices(ijk, corner, node):
    """Store the indices of a node in the domain.

    Args:
        ijk: Node indices (out), shape (3,).
        corner: Coordinates of the block, shape (3,).
        node: Number of the node in its block.
    """
    ijk[0] = 4 * corner[0] - 1 + node // 16
    ijk[1] = 4 * corner[1] - 1 + node // 4 % 4
    ijk[2] = 4 * corner[2] - 1 + node % 4


@always_inline
def own_position(movers, m, x, own):
    """Compute the initial position of a collider's point.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        x: Where the point is now, shape (3,) [m].
        own: Its position at the start (out), shape (3,) [m].
    """
    r = movers.rotation[m]
    a = x[0] - movers.about[m, 0] - movers.move[m, 0]
    b = x[1] - movers.about[m, 1] - movers.move[m, 1]
    c = x[2] - movers.about[m, 2] - movers.move[m, 2]
    for k in range(3):
        own[k] = r[0, k] * a + r[1, k] * b + r[2, k] * c + movers.about[m, k]


@always_inline
def interpolate_cell(v, base, over, up, place, spacing, sample):
    """Interpolate values and their gradient linearly in a cell of a lattice.

    Args:
        v: Values at the points, flat.
        base: Row of the cell's first corner.
        over, up: Rows from a point to the next one along x and y; along z it is 1.
        place: Place in the cell, three numbers from 0 to 1.
        spacing: Spacing of the points [m].
        sample: Gradient and value (out), shape (4,).
    """
    x, y, z = place
    a, b, c, d = v[base], v[base + 1], v[base + up], v[base + up + 1]
    e, f, g, h = v[base + over], v[base + over + 1], v[base + over + up], v[base + over + up + 1]
    low, high = a + z * (b - a), c + z * (d - c)
    low2, high2 = e + z * (f - e), g + z * (h - g)
    lower, upper = low + y * (high - low), low2 + y * (high2 - low2)
    sample[0] = (upper - lower) / spacing
    sample[1] = ((high - low) * (1 - x) + (high2 - low2) * x) / spacing
    along, along2 = (b - a) * (1 - y) + (d - c) * y, (f - e) * (1 - y) + (h - g) * y
    sample[2] = (along * (1 - x) + along2 * x) / spacing
    sample[3] = lower + x * (upper - lower)


@always_inline
def _sample(movers, m, own, sample):
    """Interpolate the distance [m] and its gradient at a point of the collider's frame.

    They are written to `sample` (4,), gradient first. Returns False outside the lattice.
    """
    nx, ny, nz = movers.shape[m, 0], movers.shape[m, 1], movers.shape[m, 2]
    x = (own[0] - movers.start[m, 0]) / movers.spacing
    y = (own[1] - movers.start[m, 1]) / movers.spacing
    z = (own[2] - movers.start[m, 2]) / movers.spacing
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    if i < 0 or j < 0 or k < 0 or i > nx - 2 or j > ny - 2 or k > nz - 2:
        return False
    x, y, z = x - i, y - j, z - k
    base = movers.first[m] + (i * ny + j) * nz + k
    interpolate_cell(movers.values, base, ny * nz, nz, (x, y, z), movers.spacing, sample)
    return True


@always_inline
def _interpolate_gradient(movers, m, own, sample):
    """Interpolate central differences of the distance linearly; they are written to sample (4,).

    At the rim of the lattice, far from the collider, `sample` stays as it is.
    """
    ny, nz = movers.shape[m, 1], movers.shape[m, 2]
    x = (own[0] - movers.start[m, 0]) / movers.spacing
    y = (own[1] - movers.start[m, 1]) / movers.spacing
    z = (own[2] - movers.start[m, 2]) / movers.spacing
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    if i < 1 or j < 1 or k < 1:
        return
    if i > movers.shape[m, 0] - 3 or j > ny - 3 or k > nz - 3:
        return
    x, y, z = x - i, y - j, z - k
    v, over, up = movers.values, ny * nz, nz
    sample[0] = sample[1] = sample[2] = 0.0
    for corner in range(8):
        a, b, c = corner // 4, corner // 2 % 2, corner % 2
        place = movers.first[m] + ((i + a) * ny + j + b) * nz + k + c
        weight = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
        sample[0] += weight * (v[place + over] - v[place - over])
        sample[1] += weight * (v[place + up] - v[place - up])
        sample[2] += weight * (v[place + 1] - v[place - 1])


@always_inline
def turn_gradient(movers, m, gradient, normal):
    """Turn a gradient to a unit normal as the collider stands now; return False if it is 0.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        gradient: Gradient in the collider's frame, shape (3,) or longer.
        normal: Unit normal, 0 without a gradient (out), shape (3,) or longer.
    """
    r = movers.rotation[m]
    size = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    for k in range(3):
        turned = r[k, 0] * gradient[0] + r[k, 1] * gradient[1] + r[k, 2] * gradient[2]
        normal[k] = turned / size if size > 0.0 else 0.0
    return size > 0.0


@always_inline
def _smooth_normal(movers, m, own, sample, normal):
    """Compute the outward normal of a collider (out), shape (3,); return False if it has none.

    sample: Gradient, which changes, and distance at `own`, shape (4,).
    """
    _interpolate_gradient(movers, m, own, sample)
    return turn_gradient(movers, m, sample, normal)


@array_function
def sample_surface(movers, m, x, normal):
    """Return the distance of a point from a collider [m], infinite where it has no normal.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        x: Point, shape (3,) [m].
        normal: Outward normal, as smooth as at nodes (out), shape (3,).
    """
    own, sample = np.zeros(3), np.zeros(4)
    own_position(movers, m, x, own)
    if not _sample(movers, m, own, sample) or not _smooth_normal(movers, m, own, sample, normal):
        return np.inf
    return sample[3]


@always_inline
def _carry(movers, m, own, x, dt, velocity):
    """Compute the mean velocity [m/s] over a step of dt [s] of the collider's point now at x."""
    r = movers.rotation_end[m]
    a = own[0] - movers.about[m, 0]
    b = own[1] - movers.about[m, 1]
    c = own[2] - movers.about[m, 2]
    for k in range(3):
        end = r[k, 0] * a + r[k, 1] * b + r[k, 2] * c + movers.about[m, k] + movers.move_end[m, k]
        velocity[k] = (end - x[k]) / dt


@device_function
def distance_from_collider(movers, m, x, own, sample):
    """Return the distance of a point from a collider [m], infinite if it is too far away.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        x: Point, shape (3,) [m].
        own, sample: Scratch, shapes (3,) and (4,).
    """
    own_position(movers, m, x, own)
    return sample[3] if _sample(movers, m, own, sample) else np.inf


@array_function
def sample_collider(movers, m, x, dt, sample, velocity):
    """Find outward normal and distance of a point from a collider, and the collider's velocity.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        x: Point, shape (3,) [m].
        dt: Time step [s].
        sample: Normal and distance [m] (out), shape (4,).
        velocity: Mean velocity of the collider at the point in the step (out), shape (3,) [m/s].

    Returns:
        False if the point is too far away, or has no normal.
    """
    own, at_start = np.zeros(3), np.zeros(4)
    sample[3] = distance_from_collider(movers, m, x, own, at_start)
    if not sample[3] < np.inf or not turn_gradient(movers, m, at_start, sample):
        return False
    _carry(movers, m, own, x, dt, velocity)
    return True


@device_function
def surface_velocity(movers, m, x, sample, dt, own, velocity):
    """Compute the velocity of a collider at the point of its surface closest to a point.

    Args:
        movers: Sampled colliders.
        m: Number of the collider.
        x: Point, shape (3,) [m].
        sample: Outward normal and distance of the point [m], shape (4,).
        dt: Time step [s].
        own: Scratch, shape (2, 4).
        velocity: Mean velocity in the step (out), shape (3,) [m/s].
    """
    for k in range(3):
        own[1, k] = x[k] - sample[3] * sample[k]
    own_position(movers, m, own[1], own[0])
    _carry(movers, m, own[0], own[1], dt, velocity)


@kernel
def evaluate_colliders(blocks, first, nearby, movers, free, dt, dx, nodes, moves, collider_number):
    """Compute the nearest collider at the nodes of blocks.

    Free bodies get no velocity, and no normal deep inside: they couple by their own velocities.

    Args:
        blocks: Blocks, shape (n, 3).
        first: Start of each block's colliders in `nearby`, shape (n + 1,).
        nearby: Numbers of the colliders near each block b, in nearby[first[b] : first[b + 1]].
        movers: Sampled colliders, see `SampledSdf`.
        free: Free bodies among them, (colliders,) bool, or without rows.
        dt: Time step [s].
        dx: Cell size [m].
        nodes: Outward normal and distance [m], infinite if no collider is near (out), shape
            (n, 64, 4).
        moves: Mean velocity in the step of the surface point nearest to the node (out), shape
            (n, 64, 3) [m/s].
        collider_number: Number of the collider (out), shape (n, 64), or (0, 64) if not wanted.
    """
    x, own, sample, velocity = np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(3)
    normal, surface = np.zeros(3), np.zeros(3)
    for b in range(len(blocks)):
        for node in range(64):
            nodes[b, node, 3] = np.inf
            store_side(movers, 0, b, node, 0)
        for m in nearby[first[b] : first[b + 1]]:
            is_free = len(free) > 0 and free[m]
            for node in range(64):
                x[0] = (4 * blocks[b, 0] - 1 + node // 16) * dx
                x[1] = (4 * blocks[b, 1] - 1 + node // 4 % 4) * dx
                x[2] = (4 * blocks[b, 2] - 1 + node % 4) * dx
                own_position(movers, m, x, own)
                if not _sample(movers, m, own, sample):
                    continue
                side = sample_side(movers, m, own, sample)
                if sample[3] >= min(nodes[b, node, 3], SDF_BAND_CELLS * dx):
                    continue
                if is_free and sample[3] < -SDF_BAND_CELLS * dx:
                    normal[:] = 0.0
                elif side != 0:
                    turn_gradient(movers, m, sample, normal)
                elif not _smooth_normal(movers, m, own, sample, normal):
                    continue
                for k in range(3):
                    nodes[b, node, k] = normal[k]
                d = sample[3]
                nodes[b, node, 3] = d
                store_side(movers, m, b, node, side)
                if len(collider_number) > 0:
                    collider_number[b, node] = m
                if is_free:
                    continue
                depth = min(max(d, -2.0 * dx), 2.0 * dx)
                for k in range(3):
                    surface[k] = x[k] - depth * normal[k]
                own_position(movers, m, surface, own)
                _carry(movers, m, own, surface, dt, velocity)
                for k in range(3):
                    moves[b, node, k] = velocity[k]
