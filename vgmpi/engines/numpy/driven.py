"""What is driven, in plain numpy: see kernels/driven.py."""

import numpy as np

from ...domain.blocks import EDGE, MIDDLE
from ...domain.driven import HEAVY, Driven, Ways
from ...domain.state import Group
from ...kernels.g2p import OUTSIDE
from ..base import DITHER, Report


def prescribe(v: np.ndarray, heavy: np.ndarray, ways: Ways, points: np.ndarray, dx: float) -> None:
    """Velocities v (phases, ..., 3) and masses (phases, ...) of what is driven, at nodes that lie
    at points (n, 3) [m]."""
    for p in np.flatnonzero(ways.driven):
        x = points - ways.about[p]
        v[p] = (x @ ways.turn[p].T + ways.shift[p]).reshape(v[p].shape)
        heavy[p] *= HEAVY


def carry(group: Group, driven: Driven, dt: float, step: int) -> Report:
    """Move the particles of what is driven."""
    p, at, dx = group.plan.phase, group.index(), driven.dx
    if p not in driven.phases:
        return Report(0.0, 0.0, (0.0,) * 3, [], [])
    turn, ways = driven.ways.turn[p], driven.ways
    v = (group.positions() - ways.about[p]) @ turn.T + ways.shift[p]
    dither = np.array([d * step % 1.0 for d in DITHER])
    units = np.floor(2.0**group.bits * (dt / dx) * v + dither)
    group.xi[:, at] += units.T.astype(group.xi.dtype)
    group.put("v", at, v)
    group.put("C", at, np.tile(turn.ravel(), (len(at), 1)))
    R = np.eye(3) + dt * turn
    for name in ("H", "F"):
        if name in group.plan.channels:
            F = np.eye(3) + group.get(name, at).astype(float).reshape(-1, 3, 3)
            group.put(name, at, (R @ F - np.eye(3)).reshape(-1, 9))
    x = np.ldexp(group.xi[:, at].T.astype(np.float64), -group.bits)
    place = x + EDGE * np.repeat(group.block, group.count, axis=0) + MIDDLE
    cells = np.array(group.lattice.cells)
    outside = ~((place > -0.5) & (place < cells + 0.5)).all(1)
    wrong = [(int(group.ids[at[k]]), OUTSIDE) for k in np.flatnonzero(outside)]
    return Report(0.0, float(np.abs(x).max()), (float(np.abs(v).max()), 0.0, 0.0), wrong, [])
