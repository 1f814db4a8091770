"""The grid's part of a step: sum the patches of each node block, turn momentum into velocity,
contact, walls.

A node block is 4^3 nodes of one phase; block b holds base nodes 4 b - 1 .. 4 b + 2 of the domain.
Its sum runs over the patches that touch it in the order of their keys, whoever owns them: that
order, and not the ranks, decides the bits.
"""

import numpy as np

from ..device.jit import inline, kernel
from .contact import TOUCH, collider_gap, geometry, resolve
from .walls import SIDE, constrain, tangential


@inline
def pull(nodes, first, last, patch_of, code_of, slots, patches):
    """Sum into nodes (256,) the overlapping parts of patches first..last of the pull list.

    code_of: 9 (di + 1) + 3 (dj + 1) + dk + 1, the node block's place relative to the patch's block;
    patches: (slots, 2048). Rows along z are added in pieces of fixed length, which compiles to a
    few vector operations.
    """
    nodes[:] = 0
    for q in range(first, last):
        slot = slots[patch_of[q]]
        if slot < 0:
            continue
        patch = patches[slot]
        code = code_of[q]
        di, dj, dk = code // 9 - 1, code // 3 % 3 - 1, code % 3 - 1
        # a patch begins one node before its block and ends two after it
        for i in range(3 if di < 0 else 0, 3 if di > 0 else 4):
            for j in range(3 if dj < 0 else 0, 3 if dj > 0 else 4):
                at = (16 * i + 4 * j) * 4
                row = ((4 * di + 1 + i) * SIDE + 4 * dj + 1 + j) * SIDE * 4
                if dk == 0:
                    for c in range(16):
                        nodes[at + c] += patch[row + 4 + c]
                elif dk < 0:
                    for c in range(4):
                        nodes[at + 12 + c] += patch[row + c]
                else:
                    for c in range(12):
                        nodes[at + c] += patch[row + 20 + c]


@kernel
def update(
    b0,
    b1,
    first,
    phase,
    block_at,
    meets,
    solid_of,
    pull_first,
    pull_patch,
    pull_code,
    slots,
    patches,
    offset_slots,
    offsets,
    grid,
    solids,
    scratch,
    cells,
    wall_kinds,
    wall_friction,
    gravity,
    least,
    rank_of,
    friction,
    dt,
    dx,
):
    """Velocities [m/s] at the nodes of blocks b0..b1, in place of momentum.

    first: (blocks + 1,) node blocks of each block, one per phase that touches it; phase: (node
    blocks,); meets: (blocks,) whether two phases, or a phase and a collider, may touch here;
    solid_of: (blocks,) row of `solids` or -1; solids: (n, 64, 4) outward normal and distance [m] of
    the collider; scratch: (phases, 64, 4); least: (phases,) mass [kg] of one full cell; rank_of:
    (phases,) order of mastery, lowest first; friction: (phases + 1, phases), the last row for the
    collider.
    """
    count = len(least)
    v = np.zeros((count, 3))
    m = np.zeros(count)
    local = np.zeros(count, np.int64)
    most = count * (count + 1) // 2
    normals = np.zeros((most, 7))
    impulse = np.zeros((most, 4))
    mu = np.zeros(most)
    pair_a, pair_b = np.zeros(most, np.int64), np.zeros(most, np.int64)
    touches = np.zeros(count, np.int64)
    size = SIDE**3 * 4
    flat_patches = patches.reshape((len(patches), size))
    flat_offsets = offsets.reshape((len(offsets), size))
    flat_grid = grid.reshape((len(grid), 256))
    flat_scratch = scratch.reshape((len(scratch), 256))
    for b in range(b0, b1):
        n0, n1 = first[b], first[b + 1]
        for nb in range(n0, n1):
            q0, q1 = pull_first[nb], pull_first[nb + 1]
            pull(flat_grid[nb], q0, q1, pull_patch, pull_code, slots, flat_patches)
            if meets[b]:
                into = flat_scratch[nb - n0]
                pull(into, q0, q1, pull_patch, pull_code, offset_slots, flat_offsets)
        o0, o1, o2 = 4 * block_at[b, 0] - 1, 4 * block_at[b, 1] - 1, 4 * block_at[b, 2] - 1
        for node in range(64):
            i, j, k = o0 + node // 16, o1 + node // 4 % 4, o2 + node % 4
            on_wall = i <= 0 or j <= 0 or k <= 0 or i >= cells[0] or j >= cells[1] or k >= cells[2]
            active = 0
            for nb in range(n0, n1):
                u = grid[nb, node]
                ph = phase[nb]
                if u[3] > 1e-20 * least[ph]:
                    for c in range(3):
                        u[c] = u[c] / u[3] + dt * gravity[c]
                    if u[3] > 1e-9 * least[ph]:
                        local[active] = nb
                        active += 1
                else:
                    u[:3] = 0
            if meets[b] and (active > 1 or (active == 1 and solid_of[b] >= 0)):
                pairs = _pairs(
                    active, local, n0, node, phase, scratch, solids, solid_of[b], rank_of,
                    friction, dx,
                    i, j, k, cells, wall_kinds, normals, mu, pair_a, pair_b, touches,
                )  # fmt: skip
                if pairs > 0:
                    for q in range(active):
                        for c in range(3):
                            v[q, c] = grid[local[q], node, c]
                        m[q] = grid[local[q], node, 3]
                    resolve(
                        v,
                        m,
                        active,
                        normals,
                        mu,
                        pair_a,
                        pair_b,
                        pairs,
                        touches[:active].max(),
                        impulse,
                    )
                    for q in range(active):
                        for c in range(3):
                            grid[local[q], node, c] = v[q, c]
            if on_wall:
                for nb in range(n0, n1):
                    constrain(grid[nb, node], i, j, k, cells, wall_kinds, wall_friction)


@inline
def _pairs(
    active,
    local,
    n0,
    node,
    phase,
    scratch,
    solids,
    solid,
    rank_of,
    friction,
    dx,
    i,
    j,
    k,
    cells,
    wall_kinds,
    normals,
    mu,
    pair_a,
    pair_b,
    touches,
):
    """The touching pairs of a node, in phase order: masters, normals and friction. Returns how
    many.
    """
    pairs = 0
    touches[:active] = 0
    for q in range(active):
        tangential(scratch[local[q] - n0, node], i, j, k, cells, wall_kinds)
    for q in range(active):
        here = scratch[local[q] - n0, node]
        ph = phase[local[q]]
        if solid >= 0 and here[3] > 0:
            gap = collider_gap(solids[solid, node], solids[solid, node, 3], here, dx)
            if gap <= TOUCH:
                for c in range(3):
                    normals[pairs, c] = solids[solid, node, c]
                pair_a[pairs], pair_b[pairs], mu[pairs] = -1, q, friction[len(rank_of), ph]
                touches[q] += 1
                pairs += 1
        for r in range(q + 1, active):
            other = phase[local[r]]
            a, b = (q, r) if rank_of[ph] < rank_of[other] else (r, q)
            xa, xb = scratch[local[a] - n0, node], scratch[local[b] - n0, node]
            if not (xa[3] > 0 and xb[3] > 0):
                continue
            if geometry(normals[pairs], xa, xb, dx) <= TOUCH:
                pair_a[pairs], pair_b[pairs], mu[pairs] = a, b, friction[ph, other]
                touches[a] += 1
                touches[b] += 1
                pairs += 1
    return pairs
