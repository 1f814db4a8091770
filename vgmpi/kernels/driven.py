"""What is driven: the velocity that nodes are given, and the particles that go as one."""

import numpy as np

from ..device.jit import inline, kernel
from ..device.tensor import moved_gradient_minus_one
from ..lanes import laws as _laws  # noqa: F401  (makes the tensors' functions callable)
from ..lanes.team import each, meet
from .g2p import OUTSIDE, note
from .records import AFFINE


@inline
def prescribe(here, nodes, phase, ways, dx):
    """Velocities of what is driven at the nodes of a block, nodes (256 node blocks,). here:
    couple.Here; ways: domain.driven.Ways."""
    meet()
    for nb in range(here.n0, here.n1 if len(ways.driven) > 0 else here.n0):
        p = phase[nb]
        if not ways.driven[p]:
            continue
        for node in each(64):
            x = (here.low_x + node // 16) * dx - ways.about[p, 0]
            y = (here.low_y + node // 4 % 4) * dx - ways.about[p, 1]
            z = (here.low_z + node % 4) * dx - ways.about[p, 2]
            for c in range(3):
                turn = ways.turn[p, c]
                at = 256 * nb + 4 * node + c
                nodes[at] = turn[0] * x + turn[1] * y + turn[2] * z + ways.shift[p, c]
    meet()


@kernel
def carry(rows, segments, block, particles, phase, ways, turned, dx, dt, motion, report):
    """Move the particles of what is driven, and turn what they carry.

    rows: (n,) segments to do; block: (segments, 3); turned: (2,) first channels of F - I, the
    law's and that beside a law that does not know it, -1 where there is none: all other state is
    that of rest, and turns with them; motion: g2p.Motion; dt [s] as it is; report: as of g2p.g2p,
    without a rate.
    """
    xi, f = particles.xi, particles.f
    turn, about = ways.turn[phase], ways.about[phase]
    dither = (motion.dither_x, motion.dither_y, motion.dither_z)
    far, fast = 0.0, 0.0
    for s in rows:
        for n in each(segments.count[s]):
            p = segments.start[s] + n
            x = _apart(0, p, xi, block[s], motion.one, dx, about)
            y = _apart(1, p, xi, block[s], motion.one, dx, about)
            z = _apart(2, p, xi, block[s], motion.one, dx, about)
            inside = True
            for a in range(3):
                v = turn[a, 0] * x + turn[a, 1] * y + turn[a, 2] * z
                v += ways.shift[phase, a]
                f[a, p] = v
                way = v * dt / dx
                xi[a, p] += int(np.floor(way * motion.one + dither[a]))
                at = float(xi[a, p]) / motion.one
                inside &= segments.limit[s, a, 0] < at < segments.limit[s, a, 1]
                far, fast = max(far, abs(at)), max(fast, abs(way))
            if not inside:
                note(report, particles.ids[p], OUTSIDE)
            for a in range(3):
                for b in range(3):
                    f[AFFINE + 3 * a + b, p] = turn[a, b]
            _turn(f, p, turn, turned, dt)
    squared = 0.0
    for a in range(3):
        for b in range(3):
            squared += turn[a, b] * turn[a, b]
    went(report, far, fast / dt, squared)


@inline
def _apart(a, p, xi, block, one, dx, about):
    """How far along axis a a particle is from the place about which it turns [m]."""
    cell = float(xi[a, p]) / one + 4 * block[a] + 1.5
    return cell * dx - about[a]


@inline
def went(report, far, speed, squared):
    """Take up what bounds the next step."""
    report[1] = max(report[1], far)
    report[4] = max(report[4], speed)
    report[5] = max(report[5], squared)


@inline
def _turn(f, p, turn, turned, dt):
    """Turn the deformation gradients of a particle, see `carry`."""
    L = (
        turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2], turn[2, 0],
        turn[2, 1], turn[2, 2],
    )  # fmt: skip
    for k in range(2):
        q = turned[k]
        if q >= 0:
            h = (
                float(f[q, p]), float(f[q + 1, p]), float(f[q + 2, p]), float(f[q + 3, p]),
                float(f[q + 4, p]), float(f[q + 5, p]), float(f[q + 6, p]), float(f[q + 7, p]),
                float(f[q + 8, p]),
            )  # fmt: skip
            h = moved_gradient_minus_one(h, L, dt)
            for c in range(9):
                f[q + c, p] = h[c]
