"""The total deformation gradient of particles whose law does not know it: for drawing alone.

A law that yields keeps the elastic part of its deformation, a fluid its volume. Where a body's
Gaussians are to follow all of it, it is carried beside the law's state and nothing else sees it.
"""

from ..device.jit import inline, kernel
from ..device.tensor import moved_gradient_minus_one
from ..lanes import laws as _laws  # noqa: F401  (makes the tensors' functions callable
from ..lanes.lanes import COUNT, store
from .records import AFFINE, nine


@kernel
def follow(segments, start, count, f, first, dt):
    """F <- (I + dt C) F with C as just gathered; carried as F - I in channels first ... first + 8.

    segments: rows of start and count (g2p.py); f: (channels, cap). Unused places have C = 0.
    """
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for s in segments:
        for p in range(start[s], start[s] + count[s], COUNT):
            turn(flat, p, cap, first, dt)


@inline
def turn(f, p, cap, first, dt):
    """That of 16 particles from p."""
    q, h = p + AFFINE * cap, p + first * cap
    c, old = nine(f, q, cap), nine(f, h, cap)
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = moved_gradient_minus_one(old, c, dt)
    store(f, h, h0)
    store(f, h + cap, h1)
    store(f, h + 2 * cap, h2)
    store(f, h + 3 * cap, h3)
    store(f, h + 4 * cap, h4)
    store(f, h + 5 * cap, h5)
    store(f, h + 6 * cap, h6)
    store(f, h + 7 * cap, h7)
    store(f, h + 8 * cap, h8)
