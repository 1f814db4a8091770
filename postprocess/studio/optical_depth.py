"""Optical depth of the liquid along straight rays, such as those of the key to a surface."""

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import RAY
from .cone_occlusion import clip
from .density_field import density
from .ray_marching import ABSORBING, MAX_STEPS, absorb, brick_leap, inverse


@njit_cached(**RAY)
def liquid_depth(medium, p, d, depth, values):
    """Write the liquid's optical depth, scattering included, along a straight ray to depth (3,).

    Args:
        medium, p, d: Liquid and ray.
        depth, values: (out) Optical depth, shape (3,), and scratch, shape (8,).

    Returns:
        Path length in the liquid [m].
    """
    field = medium.field
    depth[0] = depth[1] = depth[2] = 0.0
    begin, end = clip(field.box[:3], field.box[3:], p[0], p[1], p[2], d[0], d[1], d[2])
    t, total = begin + 0.05 * field.cell, 0.0
    c = 1.0 / field.cell
    r0, r1, r2 = inverse(d[0]), inverse(d[1]), inverse(d[2])
    for _ in range(MAX_STEPS):
        if t >= end:
            break
        u = (p[0] + t * d[0] - field.lower[0]) * c
        v = (p[1] + t * d[1] - field.lower[1]) * c
        w = (p[2] + t * d[2] - field.lower[2]) * c
        outside = brick_leap(field, u, v, w, r0, r1, r2, False)
        if outside > 0.0:
            t += (outside + 1e-4) * field.cell
            continue
        step, share = brick_leap(field, u, v, w, r0, r1, r2, True) * field.cell, 1.0
        if step <= 0.0:
            step = min(1.5 * field.cell, end - t)
            # the inner fraction of a step is linear in rho over a cell, without jumps
            h = 0.5 * step * c
            f = density(field, u + h * d[0], v + h * d[1], w + h * d[2])
            share = min(max(0.5 + 2.0 * (f - 0.5), 0.0), 1.0)
        step = min(step, end - t)
        if not medium.uniform:
            step = min(step, ABSORBING * medium.tint.cell)
        if share > 0.0:
            absorb(medium, p, d, t, t + step, share, 1.0, depth, values)
            total += share * step
        t += step + 1e-6 * field.cell
    return total
