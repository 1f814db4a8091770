"""Sparse blocks of a density field: marking, deposition of kernels, and node values."""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

BLOCK = 8  # [cells] edge of a block
NODES = BLOCK + 1  # [nodes] along a block's edge, with those of its upper neighbors
BRICK = 4  # [cells] edge of the cubes that rays skip
FULL = -2  # index of a block inside of the liquid
_SHIFT, _LAST = 3, 7
_ZERO = np.float32(0)


@njit_cached(nogil=True, error_model="numpy")
def mark_bricks(index, values, state):
    """Mark cubes of 4 cells: -1 where the density is below 1/2, 1 where it is above, 0 otherwise.

    Args:
        index: Block numbers, shape (bx, by, bz).
        values: Node values, shape (blocks, 9, 9, 9).
        state: (out) Marks, shape (2 bx, 2 by, 2 bz).
    """
    for i in range(state.shape[0]):
        for j in range(state.shape[1]):
            for k in range(state.shape[2]):
                n = index[i >> 1, j >> 1, k >> 1]
                if n < 0:
                    state[i, j, k] = 1 if n == FULL else -1
                    continue
                a, b, c = (i & 1) * BRICK, (j & 1) * BRICK, (k & 1) * BRICK
                low, high = np.float32(1e9), np.float32(-1e9)
                for p in range(a, a + BRICK + 1):
                    for q in range(b, b + BRICK + 1):
                        for r in range(c, c + BRICK + 1):
                            v = values[n, p, q, r]
                            low, high = min(low, v), max(high, v)
                state[i, j, k] = -1 if high < 0.5 else 1 if low > 0.5 else 0


@njit_cached(nogil=True, error_model="numpy")
def rows_near_surface(x, reach, distance, lower, cell, margin):
    """Return the rows of particles whose kernels come near a surface.

    Args:
        x: Positions, shape (n, 3) [m].
        reach: Kernel radii, shape (n,) [m].
        distance: Distances to the surface from inside, shape (nx, ny, nz) [m].
        lower, cell: First node, shape (3,) [m], and cell size [m] of that grid.
        margin: Additional distance [m].
    """
    out, count = np.empty(len(x), np.int64), 0
    for p in range(len(x)):
        at0 = min(max(int((x[p, 0] - lower[0]) / cell), 0), distance.shape[0] - 2)
        at1 = min(max(int((x[p, 1] - lower[1]) / cell), 0), distance.shape[1] - 2)
        at2 = min(max(int((x[p, 2] - lower[2]) / cell), 0), distance.shape[2] - 2)
        nearest = distance[at0, at1, at2]
        for c in range(1, 8):
            nearest = min(nearest, distance[at0 + (c >> 2), at1 + ((c >> 1) & 1), at2 + (c & 1)])
        if nearest <= reach[p] + margin + cell:
            out[count] = p
            count += 1
    return out[:count]


@njit_cached(nogil=True, error_model="numpy")
def mark_blocks(x, half, lower, cell, index):
    """Mark the blocks that kernels touch with 0.

    Args:
        x: Positions, shape (n, 3) [m].
        half: Half edges of the boxes around kernels, shape (n, 3) [m].
        lower: First node, shape (3,) [m].
        cell: Cell size [m].
        index: (in/out) Block numbers, shape (bx, by, bz).
    """
    size = BLOCK * cell
    for p in range(len(x)):
        a0 = max(int((x[p, 0] - half[p, 0] - lower[0]) / size), 0)
        a1 = max(int((x[p, 1] - half[p, 1] - lower[1]) / size), 0)
        a2 = max(int((x[p, 2] - half[p, 2] - lower[2]) / size), 0)
        b0 = min(int((x[p, 0] + half[p, 0] - lower[0]) / size), index.shape[0] - 1)
        b1 = min(int((x[p, 1] + half[p, 1] - lower[1]) / size), index.shape[1] - 1)
        b2 = min(int((x[p, 2] + half[p, 2] - lower[2]) / size), index.shape[2] - 1)
        for i in range(a0, b0 + 1):
            for j in range(a1, b1 + 1):
                for k in range(a2, b2 + 1):
                    index[i, j, k] = 0


@njit_cached(nogil=True, error_model="numpy")
def _add_plane(raw, start, y, z, m, first, height):
    """Add a kernel to the 64 nodes of a plane of a block: eight vectors.

    Args:
        raw: (in/out) Node values.
        start: Row of the plane's first node.
        y, z: Positions of its nodes in the plane, shape (64,) [cells].
        m: Upper triangle of the matrix of q^2, shape (6,) [1/cells2].
        first: Position of the first node relative to the kernel's center [cells].
        height: Height of the kernel.
    """
    d, a, b = first
    # the kernel is 1 - q^2 = c + y (cy + f y + g z) + z (cz + h z)
    c = np.float32(
        1.0 - m[0] * d * d - m[3] * a * a - m[5] * b * b
        - 2.0 * (m[1] * d * a + m[2] * d * b + m[4] * a * b)
    )  # fmt: skip
    cy = np.float32(-2.0 * (m[1] * d + m[3] * a + m[4] * b))
    cz = np.float32(-2.0 * (m[2] * d + m[4] * a + m[5] * b))
    f, g, h = np.float32(-m[3]), np.float32(-2.0 * m[4]), np.float32(-m[5])
    for n in range(BLOCK * BLOCK):
        t = c + y[n] * (cy + f * y[n] + g * z[n]) + z[n] * (cz + h * z[n])
        t = t if t > _ZERO else _ZERO
        raw[start + np.uint64(n)] += height * t * t * t


@njit_cached(nogil=True, error_model="numpy")
def deposit_blocks(x, half, metric, weight, lower, cell, index, raw):
    """Add weight (1 - q^2)^3 of every kernel to the nodes of the blocks that it touches.

    Args:
        x: Positions, shape (n, 3) [m].
        half: Half edges of the boxes around kernels, shape (n, 3) [m].
        metric: Upper triangles of the matrix of q^2, shape (n, 6) [1/m2].
        weight: Heights of the kernels, shape (n,).
        lower: Position of the first node, shape (3,) [m].
        cell: Cell size [m].
        index: Block numbers, shape (bx, by, bz).
        raw: (in/out) Values of their nodes, shape (blocks * 512,).
    """
    top = index.shape[0] * BLOCK - 1
    y, z = np.empty(BLOCK * BLOCK, np.float32), np.empty(BLOCK * BLOCK, np.float32)
    for n in range(BLOCK * BLOCK):
        y[n], z[n] = np.float32(n >> _SHIFT), np.float32(n & _LAST)
    m, scale = np.empty(6), 1.0 / cell
    for p in range(len(x)):
        for k in range(6):
            m[k] = metric[p, k] * cell * cell
        X, Y, Z = (
            (x[p, 0] - lower[0]) * scale,
            (x[p, 1] - lower[1]) * scale,
            (x[p, 2] - lower[2]) * scale,
        )
        e, amplitude = half[p, 0] * scale, np.float32(weight[p])
        inverse = 1.0 / (m[3] * m[5] - m[4] * m[4])
        for i in range(max(0, int(np.ceil(X - e))), min(top, int(np.floor(X + e))) + 1):
            d = i - X
            # center and half edges of the ellipse in which this plane cuts the kernel
            u = (m[4] * m[2] - m[5] * m[1]) * d * inverse
            v = (m[4] * m[1] - m[3] * m[2]) * d * inverse
            section = 1.0 - d * (m[0] * d + m[1] * u + m[2] * v)
            if section <= 0.0:
                continue
            half_y, half_z = np.sqrt(section * m[5] * inverse), np.sqrt(section * m[3] * inverse)
            j0 = max(int(np.floor(Y + u - half_y)) + 1, 0) >> _SHIFT
            j1 = min(int(np.floor(Y + u + half_y)) >> _SHIFT, index.shape[1] - 1)
            k0 = max(int(np.floor(Z + v - half_z)) + 1, 0) >> _SHIFT
            k1 = min(int(np.floor(Z + v + half_z)) >> _SHIFT, index.shape[2] - 1)
            plane = (i & _LAST) << (2 * _SHIFT)
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    block = np.int64(index[i >> _SHIFT, j, k])
                    if block < 0:  # blocks that only a rounding error touches
                        continue
                    start = np.uint64((block << 3 * _SHIFT) + plane)
                    _add_plane(
                        raw, start, y, z, m, (d, j * BLOCK - Y, k * BLOCK - Z), amplitude
                    )  # fmt: skip


@njit_cached(nogil=True, error_model="numpy")
def mark_full_blocks(index, distance, distance_lower, distance_cell, lower, cell, margin):
    """Mark untouched blocks inside of the liquid as full and other untouched ones as empty.

    Args:
        index: (in/out) Block numbers, shape (bx, by, bz).
        distance, distance_lower, distance_cell: Grid of distances to the surface from inside [m].
        lower, cell: First node, shape (3,) [m], and cell size [m] of the field.
        margin: Distance above which a block is inside [m].
    """
    for i in range(index.shape[0]):
        for j in range(index.shape[1]):
            for k in range(index.shape[2]):
                if index[i, j, k] >= 0:
                    continue
                at0 = (lower[0] + (i + 0.5) * BLOCK * cell - distance_lower[0]) / distance_cell
                at1 = (lower[1] + (j + 0.5) * BLOCK * cell - distance_lower[1]) / distance_cell
                at2 = (lower[2] + (k + 0.5) * BLOCK * cell - distance_lower[2]) / distance_cell
                a = min(max(int(at0 + 0.5), 0), distance.shape[0] - 1)
                b = min(max(int(at1 + 0.5), 0), distance.shape[1] - 1)
                c = min(max(int(at2 + 0.5), 0), distance.shape[2] - 1)
                outside = max(abs(at0 - a), abs(at1 - b), abs(at2 - c)) > 4.0 * BLOCK
                if distance[a, b, c] > margin and not outside:
                    index[i, j, k] = FULL
                else:
                    index[i, j, k] = -1


@njit_cached(nogil=True, error_model="numpy")
def assemble_nodes(index, raw, share0, share1, share2, distance, lower, cell, margin, values):
    """Fill in the node values of every block from its own and its upper neighbors' sums.

    Args:
        index: Block numbers, shape (bx, by, bz).
        raw: Sums at the nodes, shape (blocks, 8, 8, 8).
        share0, share1, share2: Fractions of a kernel inside of the walls along the axes.
        distance: Grid of distances to the surface from inside [m].
        lower, cell: First node, shape (3,) [m], and cell size [m] of the field.
        margin: Distance above which a node is inside [m].
        values: (out) Node values, shape (blocks, 9, 9, 9).
    """
    for bi in range(index.shape[0]):
        for bj in range(index.shape[1]):
            for bk in range(index.shape[2]):
                block = index[bi, bj, bk]
                if block < 0:
                    continue
                for i in range(NODES):
                    for j in range(NODES):
                        for k in range(NODES):
                            a, b, c = bi + (i >> 3), bj + (j >> 3), bk + (k >> 3)
                            v = np.float32(0.0)
                            if a < index.shape[0] and b < index.shape[1] and c < index.shape[2]:
                                other = index[a, b, c]
                                if other >= 0:
                                    v = raw[other, i & _LAST, j & _LAST, k & _LAST]
                                elif other == FULL:
                                    v = np.float32(1.0)
                            gi, gj, gk = bi * BLOCK + i, bj * BLOCK + j, bk * BLOCK + k
                            v /= share0[gi] * share1[gj] * share2[gk]
                            if v < 1.0:
                                x = (lower[0] + gi * cell - distance.lower[0]) / distance.cell
                                y = (lower[1] + gj * cell - distance.lower[1]) / distance.cell
                                z = (lower[2] + gk * cell - distance.lower[2]) / distance.cell
                                p = min(max(int(x + 0.5), 0), distance.values.shape[0] - 1)
                                q = min(max(int(y + 0.5), 0), distance.values.shape[1] - 1)
                                r = min(max(int(z + 0.5), 0), distance.values.shape[2] - 1)
                                if distance.values[p, q, r] > margin:
                                    v = np.float32(1.0)
                            values[block, i, j, k] = v
