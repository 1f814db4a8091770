"""Planes: the 4 x 4 numbers of a block at one x as a vector, four numbers along z for each y."""

from llvmlite import ir
from numba.extending import intrinsic

from .vector16 import SIMD_WIDTH

EDGE = 4


def _shuffle(lanes):
    """Return the typing function of lanes of two vectors in sequence."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), SIMD_WIDTH), list(lanes))

    def _typing_function(typing, first, second):
        def _codegen(context, builder, signature, arguments):
            return builder.shuffle_vector(*arguments, mask)

        return first(first, second), _codegen

    return _typing_function


_ROWS = range(0, SIMD_WIDTH, EDGE)
_BEFORE_Z = [k for r in _ROWS for k in (r + 3, *(SIMD_WIDTH + r + z for z in range(3)))]
_AFTER_Z = [k for r in _ROWS for k in (r + 1, r + 2, r + 3, SIMD_WIDTH + r)]


@intrinsic
def shift_from_below(typing, below, plane):
    """Return the values one step down along z; `below` is the plane of the block below."""
    return _shuffle(_BEFORE_Z)(typing, below, plane)


@intrinsic
def shift_from_above(typing, plane, above):
    """Return the values one step up along z; `above` is the plane of the block above."""
    return _shuffle(_AFTER_Z)(typing, plane, above)


@intrinsic
def shift_from_south(typing, south, plane):
    """Return the values one step back along y; `south` is the plane of the block before."""
    return _shuffle(range(SIMD_WIDTH - EDGE, 2 * SIMD_WIDTH - EDGE))(typing, south, plane)


@intrinsic
def shift_from_north(typing, plane, north):
    """Return the values one step ahead along y; `north` is the plane of the block behind."""
    return _shuffle(range(EDGE, SIMD_WIDTH + EDGE))(typing, plane, north)
