"""Total deformation gradient of particles whose law does not carry it, for rendering only.

A law with plasticity keeps the elastic part of its deformation, a fluid its volume. Where a body's
Gaussians are to follow the whole deformation, it is stored besides the law's state, and nothing
else reads it.
"""

from vgmpi.kernels.particle_records import AFFINE, load_tensor
from vgmpi.kernels.simd import material_dispatch as _laws  # noqa: F401  (makes the tensors' functions callable
from vgmpi.kernels.simd.vector16 import SIMD_WIDTH, store
from vgmpi.materials.tensor_math.tensor import update_deformation_gradient
from vgmpi.runtime.jit import borrowing_kernel, device_function


@borrowing_kernel
def update_total_deformation(segments, start, count, f, first, dt):
    """Update F <- (I + dt C) F with C as just gathered, stored as F - I.

    Unused particle slots have C = 0.

    Args:
        segments: Segments to process, shape (n,).
        start: First particle of each segment.
        count: Number of particles of each segment.
        f: Particle channels (in/out), shape (channels, cap).
        first: First of the nine channels of F - I.
        dt: Time step [s].
    """
    cap = f.shape[1]
    flat = f.reshape(f.size)
    for s in segments:
        for p in range(start[s], start[s] + count[s], SIMD_WIDTH):
            update_deformation_lanes(flat, p, cap, first, dt)


@device_function
def update_deformation_lanes(f, p, cap, first, dt):
    """Update F of 16 particles.

    Args:
        f: Particle channels, flat (in/out).
        p: Index of the first particle.
        cap: Stride of channels.
        first: First of the nine channels of F - I.
        dt: Time step [s].
    """
    q, h = p + AFFINE * cap, p + first * cap
    c, old = load_tensor(f, q, cap), load_tensor(f, h, cap)
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = update_deformation_gradient(old, c, dt)
    store(f, h, h0)
    store(f, h + cap, h1)
    store(f, h + 2 * cap, h2)
    store(f, h + 3 * cap, h3)
    store(f, h + 4 * cap, h4)
    store(f, h + 5 * cap, h5)
    store(f, h + 6 * cap, h6)
    store(f, h + 7 * cap, h7)
    store(f, h + 8 * cap, h8)
