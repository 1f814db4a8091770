"""The six walls of the domain, met at nodes.

A stick or slip wall stands on a node plane and mirrors what is inside: the momentum that falls on
the ghost nodes beyond it is folded back, reflected, onto their mirror nodes, and the ghosts'
velocities are read from the mirror. That makes the wall second order (a plain clamp at the wall
node is first order). Since every particle that touches a ghost node touches its mirror node too,
both happen inside a patch. A separate wall only pushes; it is a clamp with Coulomb friction, but
for bodies whose surfaces are known: these meet it as they meet colliders (touch.py). An open wall
does nothing: what comes near it ends (solver/sinks.py).

A patch meets a wall by a code: 4 * (index of the wall's nodes in the patch) + kind; 0 where it
meets none.
"""

import numpy as np

from ..device.jit import inline
from ..lanes.team import each, meet
from .given import folded, mirrored, stopped, weighed

STICK, SLIP, SEPARATE, OPEN = 1, 2, 3, 4  # 0: a wall that is met by contact, not at the nodes
KINDS = {"stick": STICK, "slip": SLIP, "separate": SEPARATE, "open": OPEN}
SIDE = 8


def patch_codes(block: np.ndarray, cells: tuple, kinds: np.ndarray) -> np.ndarray:
    """Wall codes of patches. block: (n, 3) block coordinates; kinds: (3, 2) wall kinds, 0 for one
    that is not met -> (n, 3, 2) int32.

    Block b holds base nodes 4 b - 1 .. 4 b + 2, so its patch begins at node 4 b - 2.
    """
    codes = np.zeros((len(block), 3, 2), np.int32)
    for a in range(3):
        for side, node in ((0, 0), (1, cells[a])):
            at = node - (4 * block[:, a] - 2)
            ghost = at - 1 if side == 0 else at + 1
            met = (at >= 1) & (at <= 6) & (ghost >= 0) & (ghost <= 7)
            met &= 0 < kinds[a, side] < OPEN
            codes[met, a, side] = 4 * at[met] + kinds[a, side]
    return codes


@inline
def _node(patch, a, plane, i, j):
    """The node (i, j) of a plane across axis a."""
    if a == 0:
        return patch[plane, i, j]
    if a == 1:
        return patch[i, plane, j]
    return patch[i, j, plane]


@inline
def fold(patch, mirror, as_offset, ghosts, s):
    """Add what lies on the ghost nodes of stick and slip walls to their mirror nodes, reflected.

    as_offset: the patch holds volume and offset, which a wall always reflects as slip does; ghosts:
    given.Ghosts where momentum's change is to be told of segment s, or None.
    """
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            kind = code & 3
            if code == 0 or kind == SEPARATE:
                continue
            wall = code >> 2
            step = 1 if side == 0 else -1
            for q in each(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                inner = _node(patch, a, wall + step, i, j)
                ghost = _node(patch, a, wall - step, i, j)
                folded(ghosts, s, a, side, wall, i, j, ghost, kind == STICK)
                for c in range(4):
                    odd = c == a or (kind == STICK and c < 3 and not as_offset)
                    inner[c] += -ghost[c] if odd else ghost[c]
                    ghost[c] = 0
            meet()
    if ghosts is not None:
        _weigh(patch, mirror, ghosts, s)


@inline
def _weigh(patch, mirror, ghosts, s):
    """Keep the masses beyond walls that only push."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code & 3 != SEPARATE:
                continue
            beyond = (code >> 2) - 1 if side == 0 else (code >> 2) + 1
            for q in each(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                weighed(ghosts, s, a, side, i, j, _node(patch, a, beyond, i, j))


@inline
def reflect(patch, mirror, ghosts, share, s):
    """Set the velocities of the ghost nodes beyond walls from their mirror nodes. ghosts: see
    `fold`; share: of what that gives, how much particles take up."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0:
                continue
            wall = code >> 2
            kind = code & 3
            step = 1 if side == 0 else -1
            for q in each(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                inner = _node(patch, a, wall + step, i, j)
                ghost = _node(patch, a, wall - step, i, j)
                if kind != SEPARATE:
                    ghost[3] = inner[3]
                for c in range(3):
                    if kind == STICK or (kind == SLIP and c == a):
                        ghost[c] = -inner[c]
                    elif kind == SLIP:
                        ghost[c] = inner[c]
                    elif c == a:
                        # a wall that only pushes: interpolated at the wall the flow must not
                        # enter it
                        before = ghost[c]
                        most = max(ghost[c], -inner[c])
                        ghost[c] = most if side == 0 else min(ghost[c], -inner[c])
                        more = ghost[c] - before
                        x, y, z = _along(a, more)
                        mirrored(ghosts, share, s, a, side, wall, i, j, x, y, z)
            meet()
    if ghosts is not None:
        _tell(patch, mirror, ghosts, share, s)


@inline
def whole_at_walls(patch, mirror):
    """Complete the masses of nodes on stick and slip walls, which hold what one side of them gave:
    the other is its image."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0 or code & 3 == SEPARATE:
                continue
            for q in each(SIDE * SIDE):
                node = _node(patch, a, code >> 2, q // SIDE, q % SIDE)
                node[3] = 2.0 * node[3]
            meet()


@inline
def _along(a, value):
    """A vector along axis a."""
    none = 0.0 * value
    return value if a == 0 else none, value if a == 1 else none, value if a == 2 else none


@inline
def _tell(patch, mirror, ghosts, share, s):
    """What differs from their mirror image beyond stick and slip walls, when all is reflected."""
    for a in range(3):
        for side in range(2):
            code = mirror[a, side]
            if code == 0 or code & 3 == SEPARATE:
                continue
            wall = code >> 2
            step = 1 if side == 0 else -1
            for q in each(SIDE * SIDE):
                i, j = q // SIDE, q % SIDE
                inner = _node(patch, a, wall + step, i, j)
                ghost = _node(patch, a, wall - step, i, j)
                x, y, z = ghost[0] - inner[0], ghost[1] - inner[1], ghost[2] - inner[2]
                mirrored(ghosts, share, s, a, side, wall, i, j, x, y, z)


@inline
def constrain(nodes, first, low, cells, kinds, friction, given):
    """What the walls leave of the velocities of a node block, nodes[first:first + 256], whose first
    node is `low`. given: given.Given, which is told what they give to it, or None."""
    for a in range(3):
        stride = 16 if a == 0 else (4 if a == 1 else 1)
        one, two = (4, 1) if a == 0 else ((16, 1) if a == 1 else (16, 4))
        for side in range(2):
            kind = kinds[a, side]
            for plane in range(4):
                node = low[a] + plane
                into = -node if side == 0 else node - cells[a]
                if kind == 0 or kind == OPEN or into < 0 or (into > 0 and kind != SEPARATE):
                    continue
                for q in each(16):
                    at = plane * stride + q // 4 * one + q % 4 * two
                    v = first + 4 * at
                    before = nodes[v], nodes[v + 1], nodes[v + 2]
                    if kind == STICK:
                        nodes[v] = nodes[v + 1] = nodes[v + 2] = 0
                    elif kind == SLIP:
                        nodes[v + a] = 0
                    else:
                        push = -nodes[v + a] if side == 0 else nodes[v + a]
                        if push > 0:
                            nodes[v + a] = 0
                            slow(nodes, v, friction[a, side] * push)
                    after = nodes[v], nodes[v + 1], nodes[v + 2], nodes[v + 3]
                    stopped(given, a, side, side * cells[a], at, low, before, after)
                meet()


@inline
def slow(nodes, at, most):
    """Reduce the length of a velocity, nodes[at:at + 3], by at most `most`: Coulomb friction on
    what is left after the normal part.
    """
    x, y, z = nodes[at], nodes[at + 1], nodes[at + 2]
    size = np.sqrt(x * x + y * y + z * z)
    if size > most:
        keep = (size - most) / size
    else:
        keep = 0.0 * most
    for c in range(3):
        nodes[at + c] *= keep


@inline
def tangential(offsets, at, i, j, k, cells, kinds):
    """Drop the normal part of a volume offset, offsets[at:at + 4], at the nodes of a mirroring
    wall, where its mirror cancels it.
    """
    for a in range(3):
        node = i if a == 0 else (j if a == 1 else k)
        if (node == 0 and kinds[a, 0] < SEPARATE) or (node == cells[a] and kinds[a, 1] < SEPARATE):
            offsets[at + a] = 0
