"""Masks of lanes: which particles of a vector are in range, and numbers in these alone."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .vector16 import SIMD_WIDTH

_I32 = ir.IntType(32)
ALL_LANES = np.int64((1 << SIMD_WIDTH) - 1)


def _first_lanes(builder, count):
    """Emit bits 0 to count - 1 of a 16-bit mask; count may be above 16."""
    count = builder.trunc(count, _I32)
    full = builder.icmp_signed(">=", count, _I32(SIMD_WIDTH))
    some = builder.sub(builder.shl(_I32(1), builder.select(full, _I32(0), count)), _I32(1))
    return builder.trunc(
        builder.select(full, _I32((1 << SIMD_WIDTH) - 1), some), ir.IntType(SIMD_WIDTH)
    )


@intrinsic
def in_range_mask(typing, values, low, high, count):
    """Return the mask of the first `count` lanes with low < value < high; NaN fails.

    Args:
        values, low, high, count: Vector, bounds, and number of lanes.
    """

    def _codegen(context, builder, signature, arguments):
        v, low, high, count = arguments
        yes = builder.and_(builder.fcmp_ordered(">", v, low), builder.fcmp_ordered("<", v, high))
        mask = builder.bitcast(yes, ir.IntType(SIMD_WIDTH))
        mask = builder.and_(mask, _first_lanes(builder, count))
        return builder.zext(mask, ir.IntType(64))

    return types.int64(values, values, values, types.int64), _codegen


@intrinsic
def first_n(typing, values, count):
    """Return the first `count` numbers, then 0; count may be above 16."""

    def _codegen(context, builder, signature, arguments):
        mask = _first_lanes(builder, arguments[1])
        bits = builder.bitcast(mask, ir.VectorType(ir.IntType(1), SIMD_WIDTH))
        return builder.select(bits, arguments[0], values.constant(0.0))

    return values(values, types.int64), _codegen


@intrinsic
def masked(typing, mask, values):
    """Return values in the lanes of a mask, 0 elsewhere."""

    def _codegen(context, builder, signature, arguments):
        bits = builder.bitcast(
            builder.trunc(arguments[0], ir.IntType(SIMD_WIDTH)),
            ir.VectorType(ir.IntType(1), SIMD_WIDTH),
        )
        return builder.select(bits, arguments[1], values.constant(0.0))

    return values(types.int64, values), _codegen
