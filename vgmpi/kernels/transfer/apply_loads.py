"""Loads, which act on particles before the transfer to the grid."""

from vgmpi.runtime.jit import kernel


@kernel
def push(f, indices, dv):
    """Add a velocity change to some particles.

    With linear transfers this is the grid force of these particles, m dv / dt each, spread by their
    own weights.

    Args:
        f: Particle channels (in/out), shape (channels, cap).
        places: Particle indices, shape (n,).
        dv: Velocity change, shape (3,) [m/s].
    """
    for a in range(3):
        row, change = f[a], dv[a]
        for p in indices:
            row[p] += change
