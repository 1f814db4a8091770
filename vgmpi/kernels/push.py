"""Loads act on particles before these go to the grid."""

from ..device.jit import kernel


@kernel
def push(f, places, dv):
    """Add dv (3,) [m/s] to the velocities of the particles at `places` (n,); f: (channels, cap).

    With linear transfers this is the grid force of these particles, m dv / dt each, spread by their
    own weights.
    """
    for a in range(3):
        row, change = f[a], dv[a]
        for p in places:
            row[p] += change
