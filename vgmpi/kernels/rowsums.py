"""Between records and the nine rows of nodes around each particle: added to a patch, or gathered
from it.
"""

import numpy as np

from ..device.jit import inline
from ..lanes.lanes import load, store
from ..lanes.rows import repeat, slope_change, slope_middle, spread, steps, store_sum, stretch
from .records import PLANE, ROW


@inline
def scatter(count, records, weights, base, patch):
    """Add records to the patch, nine rows each; particles with one base row are summed first."""
    k = steps(patch)
    zero = spread(patch, 0.0)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    here = base[0]
    for n in range(count + 1):
        if n == count or base[n] != here:
            o = np.int64(here)
            store(patch, o, load(patch, o) + r0)
            store(patch, o + ROW, load(patch, o + ROW) + r1)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r2)
            o += PLANE
            store(patch, o, load(patch, o) + r3)
            store(patch, o + ROW, load(patch, o + ROW) + r4)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r5)
            o += PLANE
            store(patch, o, load(patch, o) + r6)
            store(patch, o + ROW, load(patch, o + ROW) + r7)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + r8)
            r0, r1, r2, r3, r4, r5, r6, r7, r8 = (
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
                zero,
            )
            if n == count:
                break
            here = base[n]
        m = 16 * n
        w = stretch(weights, m + 8)
        along_x, along_y, along_z = (
            repeat(records, m + 4),
            repeat(records, m + 8),
            repeat(records, m + 12),
        )
        a = repeat(records, m) + weights[m + 3] * along_x + weights[m + 7] * along_y
        a = (a + (k + weights[m + 12]) * along_z) * w
        along_x, along_y = w * along_x, w * along_y
        b = a + along_y
        c = b + along_y
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        a, b, c = w0 * a, w1 * b, w2 * c
        da, db, dc = w0 * along_x, w1 * along_x, w2 * along_x
        u = weights[m]
        r0, r1, r2 = r0 + u * a, r1 + u * b, r2 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 1]
        r3, r4, r5 = r3 + u * a, r4 + u * b, r5 + u * c
        a, b, c = a + da, b + db, c + dc
        u = weights[m + 2]
        r6, r7, r8 = r6 + u * a, r7 + u * b, r8 + u * c


@inline
def scatter_slopes(count, records, weights, base, patch):
    """As `scatter`, with the gradients of the B-splines in place of weight times offset."""
    middle, change = slope_middle(patch), slope_change(patch)
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        w = stretch(weights, m + 8)
        a = repeat(records, m) * w + repeat(records, m + 12) * (middle + change * weights[m + 12])
        bx, by = repeat(records, m + 4) * w, repeat(records, m + 8) * w
        x, y = weights[m + 3], weights[m + 7]
        y0, y1, y2 = -0.25 * (1.5 + y), 0.5 * (1.0 + y), -0.25 * (0.5 + y)
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        a0, a1, a2 = w0 * a + y0 * by, w1 * a + y1 * by, w2 * a + y2 * by
        b0, b1, b2 = w0 * bx, w1 * bx, w2 * bx
        for i in range(3):
            u = weights[m + i]
            g = -0.25 * (1.5 + x) if i == 0 else (0.5 * (1.0 + x) if i == 1 else -0.25 * (0.5 + x))
            store(patch, o, load(patch, o) + u * a0 + g * b0)
            store(patch, o + ROW, load(patch, o + ROW) + u * a1 + g * b1)
            store(patch, o + 2 * ROW, load(patch, o + 2 * ROW) + u * a2 + g * b2)
            o += PLANE


@inline
def moments(count, records, weights, base, patch):
    """Records of velocity 0-2 and of its moments with the offset along x 4-6, y 8-10, z 12-14."""
    k = steps(patch)
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m]
        total, total_y = u * t, u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m + 1]
        total_x = u * t
        total, total_y = total + total_x, total_y + u * y
        o += PLANE
        last = w2 * load(patch, o + 2 * ROW)
        y = w1 * load(patch, o + ROW) + last
        t = w0 * load(patch, o) + y
        y = y + last
        u = weights[m + 2]
        far = u * t
        total, total_x, total_y = total + far, total_x + far + far, total_y + u * y
        w = stretch(weights, m + 8)
        total = total * w
        store_sum(records, m, total)
        store_sum(records, m + 4, total_x * w + weights[m + 3] * total)
        store_sum(records, m + 8, total_y * w + weights[m + 7] * total)
        store_sum(records, m + 12, total * (k + weights[m + 12]))


@inline
def slopes(count, records, weights, base, patch):
    """As `moments`, with the gradients of the B-splines in place of weight times offset."""
    middle, change = slope_middle(patch), slope_change(patch)
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        x, y = weights[m + 3], weights[m + 7]
        y0, y1, y2 = -0.25 * (1.5 + y), 0.5 * (1.0 + y), -0.25 * (0.5 + y)
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        zero = spread(patch, 0.0)
        total, gx, gy = zero, zero, zero
        for i in range(3):
            a, b, c = load(patch, o), load(patch, o + ROW), load(patch, o + 2 * ROW)
            t = w0 * a + w1 * b + w2 * c
            u = weights[m + i]
            g = -0.25 * (1.5 + x) if i == 0 else (0.5 * (1.0 + x) if i == 1 else -0.25 * (0.5 + x))
            total, gx = total + u * t, gx + g * t
            gy = gy + u * (y0 * a + y1 * b + y2 * c)
            o += PLANE
        w = stretch(weights, m + 8)
        store_sum(records, m, total * w)
        store_sum(records, m + 4, gx * w)
        store_sum(records, m + 8, gy * w)
        store_sum(records, m + 12, total * (middle + change * weights[m + 12]))


@inline
def values(count, records, weights, base, patch):
    """Records of what is gathered alone, without its moments: 0-2."""
    for n in range(count):
        m = 16 * n
        o = np.int64(base[n])
        w0, w1, w2 = weights[m + 4], weights[m + 5], weights[m + 6]
        total = spread(patch, 0.0)
        for i in range(3):
            t = w0 * load(patch, o) + w1 * load(patch, o + ROW) + w2 * load(patch, o + 2 * ROW)
            total = total + weights[m + i] * t
            o += PLANE
        store_sum(records, m, total * stretch(weights, m + 8))


@inline
def rest(count, records):
    """Nothing in the records behind the last one, up to a whole vector: unused places stay so."""
    for m in range(16 * count, 16 * ((count + 15) & ~15)):
        records[m] = 0


@inline
def columns(count, records, out, first, stride):
    """The first three numbers of each record into rows of out, `stride` numbers apart."""
    for n in range(count):
        for c in range(3):
            out[first + c * stride + n] = records[16 * n + c]
