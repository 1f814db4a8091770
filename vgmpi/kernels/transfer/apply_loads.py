"""Loads, which act on particles before the transfer to the grid."""

from vgmpi.runtime.jit import kernel


@kernel
def push(f, indices, dv):
    """Add a velocity change to some particles.

    With linear transfers this is the grid force of these particles, m dv / dt each, spread by their
    own weights.

    Args:
        f: Particle channels (in/out), shape (channels, cap).
        indices: Particle indices, shape (n,).
        dv: Velocity change, shape (3,) [m/s].
    """
    for a in range(3):
        row, change = f[a], dv[a]
        for p in indices:
            row[p] += change


@kernel
def damp(f, indices, rows, factor):
    """Scale some channels of some particles.

    Args:
        f: Particle channels (in/out), shape (channels, cap).
        indices: Particle indices, shape (n,).
        rows: Numbers of the channels, shape (m,).
        factor: Fraction that is left [-].
    """
    for row in rows:
        for p in indices:
            f[row, p] *= factor
