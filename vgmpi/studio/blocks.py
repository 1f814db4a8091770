"""Sparse blocks of a density field: which there are, and the sums of kernels at their nodes."""

import numpy as np

from vgmpi.caching import cached

BLOCK = 8  # cells of a block's edge
NODES = BLOCK + 1  # of a block, with those of its upper neighbors
BRICK = 4  # cells of the cubes that rays leap over
FULL = -2  # a block inside of the liquid
_SHIFT, _LAST = 3, 7
_ZERO = np.float32(0)


@cached(nogil=True, error_model="numpy")
def mark_bricks(index, values, state):
    """-1 for cubes below 1/2, 1 for cubes above, 0 for others."""
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


@cached(nogil=True, error_model="numpy")
def rows_near_surface(x, reach, far, lower, cell, margin):
    """Rows of the particles whose kernels come near to a surface."""
    out, count = np.empty(len(x), np.int64), 0
    for p in range(len(x)):
        at0 = min(max(int((x[p, 0] - lower[0]) / cell), 0), far.shape[0] - 2)
        at1 = min(max(int((x[p, 1] - lower[1]) / cell), 0), far.shape[1] - 2)
        at2 = min(max(int((x[p, 2] - lower[2]) / cell), 0), far.shape[2] - 2)
        least = far[at0, at1, at2]
        for c in range(1, 8):
            least = min(least, far[at0 + (c >> 2), at1 + ((c >> 1) & 1), at2 + (c & 1)])
        if least <= reach[p] + margin + cell:
            out[count] = p
            count += 1
    return out[:count]


@cached(nogil=True, error_model="numpy")
def mark_blocks(x, half, lower, cell, index):
    """Mark the blocks that kernels touch with 0."""
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


@cached(nogil=True, error_model="numpy")
def _add_plane(raw, at, y, z, m, first, height):
    """Add a kernel to the 64 nodes of a plane of a block: eight vectors.

    Args:
        raw: node values, in/out.
        at: row of the plane's first node.
        y, z: (64,) places of its nodes in it.
        m: (6,) upper triangle of the matrix of q^2 [1/cells2].
        first: place of the first node from the kernel's middle [cells].
        height: of the kernel.
    """
    d, a, b = first
    # 1 - q^2 = c + y (cy + f y + g z) + z (cz + h z)
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
        raw[at + np.uint64(n)] += height * t * t * t


@cached(nogil=True, error_model="numpy")
def deposit_blocks(x, half, metric, weight, lower, cell, index, raw):
    """Add weight (1 - q^2)^3 of every kernel to the nodes of the blocks that it touches.

    Args:
        x: (n, 3) positions [m].
        half: (n, 3) half edges of the boxes around kernels [m].
        metric: (n, 6) upper triangles of the matrix of q^2 [1/m2].
        weight: (n,) at their middles.
        lower: (3,) position of the first node [m].
        cell: edge [m].
        index: (bx, by, bz) number of a block.
        raw: (blocks * 512,) in/out, values of their nodes.
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
        e, height = half[p, 0] * scale, np.float32(weight[p])
        inverse = 1.0 / (m[3] * m[5] - m[4] * m[4])
        for i in range(max(0, int(np.ceil(X - e))), min(top, int(np.floor(X + e))) + 1):
            d = i - X
            # an ellipse in this plane: its middle, and its half edges where it is cut
            u = (m[4] * m[2] - m[5] * m[1]) * d * inverse
            v = (m[4] * m[1] - m[3] * m[2]) * d * inverse
            most = 1.0 - d * (m[0] * d + m[1] * u + m[2] * v)
            if most <= 0.0:
                continue
            wide, tall = np.sqrt(most * m[5] * inverse), np.sqrt(most * m[3] * inverse)
            j0 = max(int(np.floor(Y + u - wide)) + 1, 0) >> _SHIFT
            j1 = min(int(np.floor(Y + u + wide)) >> _SHIFT, index.shape[1] - 1)
            k0 = max(int(np.floor(Z + v - tall)) + 1, 0) >> _SHIFT
            k1 = min(int(np.floor(Z + v + tall)) >> _SHIFT, index.shape[2] - 1)
            plane = (i & _LAST) << (2 * _SHIFT)
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    number = np.int64(index[i >> _SHIFT, j, k])
                    if number < 0:  # touched by a rounding error alone
                        continue
                    at = np.uint64((number << 3 * _SHIFT) + plane)
                    _add_plane(
                        raw, at, y, z, m, (d, j * BLOCK - Y, k * BLOCK - Z), height
                    )  # fmt: skip


@cached(nogil=True, error_model="numpy")
def mark_full_blocks(index, far, far_lower, far_cell, lower, cell, margin):
    """Mark untouched blocks that lie inside of the liquid as full."""
    for i in range(index.shape[0]):
        for j in range(index.shape[1]):
            for k in range(index.shape[2]):
                if index[i, j, k] >= 0:
                    continue
                at0 = (lower[0] + (i + 0.5) * BLOCK * cell - far_lower[0]) / far_cell
                at1 = (lower[1] + (j + 0.5) * BLOCK * cell - far_lower[1]) / far_cell
                at2 = (lower[2] + (k + 0.5) * BLOCK * cell - far_lower[2]) / far_cell
                a = min(max(int(at0 + 0.5), 0), far.shape[0] - 1)
                b = min(max(int(at1 + 0.5), 0), far.shape[1] - 1)
                c = min(max(int(at2 + 0.5), 0), far.shape[2] - 1)
                outside = max(abs(at0 - a), abs(at1 - b), abs(at2 - c)) > 4.0 * BLOCK
                if far[a, b, c] > margin and not outside:
                    index[i, j, k] = FULL
                else:
                    index[i, j, k] = -1


@cached(nogil=True, error_model="numpy")
def assemble_nodes(index, raw, share0, share1, share2, far, lower, cell, margin, values):
    """Node values of every block from its own and its upper neighbors' sums."""
    for bi in range(index.shape[0]):
        for bj in range(index.shape[1]):
            for bk in range(index.shape[2]):
                own = index[bi, bj, bk]
                if own < 0:
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
                                x = (lower[0] + gi * cell - far.lower[0]) / far.cell
                                y = (lower[1] + gj * cell - far.lower[1]) / far.cell
                                z = (lower[2] + gk * cell - far.lower[2]) / far.cell
                                p = min(max(int(x + 0.5), 0), far.values.shape[0] - 1)
                                q = min(max(int(y + 0.5), 0), far.values.shape[1] - 1)
                                r = min(max(int(z + 0.5), 0), far.values.shape[2] - 1)
                                if far.values[p, q, r] > margin:
                                    v = np.float32(1.0)
                            values[own, i, j, k] = v
