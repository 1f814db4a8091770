"""What is rigid gives to bodies in a step: impulse, its moment and work, by collider, body that is
driven, and wall.

Sums are whole numbers of quanta, so that their terms may come in any order. Where nobody asks for
them `given` is None, and nothing of this is compiled in. Terms come from three places: what rigid
things do at nodes (touch.py, walls.constrain); what folding at a mirroring wall does to momentum
(walls.fold); and what particles gather of the mirrored velocities (walls.reflect), the impulse of
which is the ghost nodes' own mass times the difference from their mirror image.
"""

from typing import NamedTuple

import numpy as np

from ..device.jit import inline
from ..lanes.team import count_up

NUMBERS = 7  # of a row: impulse [kg m/s], moment about the domain's origin [kg m2/s], work [J]
WALLS = 6
PLANE = 64  # nodes of a patch in a plane


class Given(NamedTuple):
    """Sums of one thread, and at which node and for whom it is at work."""

    # (rows, 7) int64, rows: colliders, what is driven, then walls: west, east; south, north; ...
    sums: np.ndarray
    quanta: np.ndarray  # (7,) what 1 of them is worth: powers of two
    counts: np.ndarray  # (blocks, 64) uint8: nodes that this rank counts, and no other
    now: np.ndarray  # (3,) block, node and row at work
    node: np.ndarray  # (3,) [m] where that node is
    at: np.ndarray  # (3,) [m] where the surface is that acts on it
    pairs: np.ndarray  # (m,) row of each pair that meets at a node
    places: np.ndarray  # (m, 3) [m] where its rigid surface is
    first: int  # row of the first wall
    dx: float  # [m]


class Ghosts(NamedTuple):
    """The segments of a group that reach beyond walls."""

    given: Given  # of the calling thread
    slot: np.ndarray  # (segments,) row of mass, -1 of those far from walls
    low: np.ndarray  # (segments, 3) first node of each patch
    mass: np.ndarray  # (n, 6, 64) [kg] own mass of the nodes beyond each wall
    share: float  # of an impulse by the momentum's mirror that particles take up
    kept: float  # the same by the mirror of the velocity's change (FLIP)
    weighs: int  # whether what is summed has the mass


def given(rows: int, quanta: np.ndarray, phases: int, dx: float) -> Given:
    """Empty sums of one thread."""
    m = phases * (phases + 1) // 2 + 3 * phases
    return Given(
        np.zeros((rows, NUMBERS), np.int64), quanta, np.zeros((0, 64), np.uint8),
        np.zeros(3, np.int64), np.zeros(3), np.zeros(3), np.zeros(m, np.int64), np.zeros((m, 3)),
        rows - WALLS, dx,
    )  # fmt: skip


@inline
def _add(given, row, at, jx, jy, jz, work):
    """An impulse (3,) [kg m/s] on bodies at a place [m], and its work [J]."""
    own, quanta = given.sums[row], given.quanta
    count_up(own, 0, np.int64(np.rint(jx / quanta[0])))
    count_up(own, 1, np.int64(np.rint(jy / quanta[1])))
    count_up(own, 2, np.int64(np.rint(jz / quanta[2])))
    count_up(own, 3, np.int64(np.rint((at[1] * jz - at[2] * jy) / quanta[3])))
    count_up(own, 4, np.int64(np.rint((at[2] * jx - at[0] * jz) / quanta[4])))
    count_up(own, 5, np.int64(np.rint((at[0] * jy - at[1] * jx) / quanta[5])))
    count_up(own, 6, np.int64(np.rint(work / quanta[6])))


# ---- at nodes -----------------------------------------------------------------------------------


@inline
def at_block(given, b):
    """What follows is at block b."""
    if given is not None:
        given.now[0] = b


@inline
def at_node(given, node, i, j, k):
    """What follows is at a node of it, (i, j, k) of the domain."""
    if given is not None:
        given.now[1] = node
        given.node[0], given.node[1], given.node[2] = i * given.dx, j * given.dx, k * given.dx


@inline
def by_collider(given, number, surface):
    """What follows is done by a collider. surface: (4,) its outward normal, and distance [m]."""
    if given is not None:
        given.now[2] = number
        for c in range(3):
            given.at[c] = given.node[c] - surface[3] * surface[c]


@inline
def by_wall(given, a, side):
    """What follows is done by a wall."""
    if given is not None:
        given.now[2] = given.first + 2 * a + side
        for c in range(3):
            given.at[c] = given.node[c]


@inline
def _counted(given):
    return given.counts[given.now[0], given.now[1]] != 0


@inline
def pressed(given, before, after, mass, speed, was, pairs):
    """What is rigid and moves by `speed` (3,) [m/s] has changed a phase of `mass` [kg] at the node
    from `before` (3,) to `after` (3,), and is in the pairs from `was` on."""
    if given is not None:
        for q in range(was, pairs):
            given.pairs[q] = given.now[2]
            for c in range(3):
                given.places[q, c] = given.at[c]
        if _counted(given):
            m = np.float64(mass)
            jx, jy, jz = (
                m * (after[0] - before[0]), m * (after[1] - before[1]), m * (after[2] - before[2])
            )  # fmt: skip
            work = jx * speed[0] + jy * speed[1] + jz * speed[2]
            _add(given, given.now[2], given.at, jx, jy, jz, work)


@inline
def drove(given, row, before, after, mass, speed, was, pairs):
    """As `pressed`, of a body that is driven: it acts where the node is. row: its own, -1 where
    none of two phases is driven."""
    if given is not None:
        for q in range(was, pairs):
            given.pairs[q] = row
        if row >= 0:
            given.now[2] = row
            for c in range(3):
                given.at[c] = given.node[c]
            pressed(given, before, after, mass, speed, was, pairs)


@inline
def resolved(given, pairs, room):
    """Impulses of pairs of which one is rigid or driven. room: touch.Room."""
    if given is not None:
        if _counted(given):
            for q in range(pairs):
                if given.pairs[q] >= 0:
                    a, b, n, push = room.master[q], room.other[q], room.normals[q], room.impulse[q]
                    # of two phases the one that is driven is the heavier by far
                    first = a < 0 or room.heavy[a] > room.heavy[b]
                    k, speed = (1.0, room.v[a]) if first else (-1.0, room.v[b])
                    jx = k * (push[0] * n[0] + push[1])
                    jy = k * (push[0] * n[1] + push[2])
                    jz = k * (push[0] * n[2] + push[3])
                    work = jx * speed[0] + jy * speed[1] + jz * speed[2]
                    _add(given, given.pairs[q], given.places[q], jx, jy, jz, work)


@inline
def stopped(given, a, side, plane, node, low, before, v):
    """A wall on a plane of nodes across axis a has changed velocities at a node of a block whose
    first is `low`, from `before` to v (4,), and mass."""
    if given is not None:
        at_node(given, node, low[0] + node // 16, low[1] + node // 4 % 4, low[2] + node % 4)
        if _counted(given):
            given.node[a] = plane * given.dx
            m = np.float64(v[3])
            jx, jy, jz = m * (v[0] - before[0]), m * (v[1] - before[1]), m * (v[2] - before[2])
            _add(given, given.first + 2 * a + side, given.node, jx, jy, jz, 0.0)


# ---- in patches ---------------------------------------------------------------------------------


@inline
def _on_plane(ghosts, s, a, side, wall, i, j, jx, jy, jz):
    """An impulse at a node (i, j) of a patch's plane, on the wall across axis a at node `wall`."""
    at, low = ghosts.given.at, ghosts.low[s]
    one, two = (1, 2) if a == 0 else ((0, 2) if a == 1 else (0, 1))
    at[a], at[one], at[two] = low[a] + wall, low[one] + i, low[two] + j
    for c in range(3):
        at[c] *= ghosts.given.dx
    _add(ghosts.given, ghosts.given.first + 2 * a + side, at, jx, jy, jz, 0.0)


@inline
def folded(ghosts, s, a, side, wall, i, j, ghost, stick):
    """Momentum of a ghost node (4,) is about to be folded: a mirror turns what is odd in it."""
    if ghosts is not None:
        if ghosts.weighs != 0:
            ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j] = ghost[3]
        k = -2.0 * ghosts.share
        jx = k * ghost[0] if stick or a == 0 else 0.0
        jy = k * ghost[1] if stick or a == 1 else 0.0
        jz = k * ghost[2] if stick or a == 2 else 0.0
        _on_plane(ghosts, s, a, side, wall, i, j, jx, jy, jz)


@inline
def weighed(ghosts, s, a, side, i, j, ghost):
    """The mass of a node (4,) beyond a wall that does not mirror."""
    if ghosts is not None:
        if ghosts.weighs != 0:
            ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j] = ghost[3]


@inline
def mirrored(ghosts, share, s, a, side, wall, i, j, dx, dy, dz):
    """Particles gather at a node beyond a wall a velocity that differs by (dx, dy, dz) [m/s] from
    where its momentum went."""
    if ghosts is not None:
        m = share * ghosts.mass[ghosts.slot[s], 2 * a + side, 8 * i + j]
        _on_plane(ghosts, s, a, side, wall, i, j, m * dx, m * dy, m * dz)


@inline
def share_of(ghosts):
    """How much of an impulse by the momentum's mirror particles take up."""
    if ghosts is not None:
        return ghosts.share
    return 1.0


@inline
def kept_of(ghosts):
    """The same by the mirror of the velocity's change."""
    if ghosts is not None:
        return ghosts.kept
    return 1.0
