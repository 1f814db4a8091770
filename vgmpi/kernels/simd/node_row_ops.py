"""Vector operations on a row of four nodes, xyzm xyzm xyzm xyzm: a vector and a number per node."""

from llvmlite import ir
from numba.extending import intrinsic

from .row_ops import _mask
from .vector16 import SIMD_WIDTH

_FOURTH = [4 * (k // 4) + 3 for k in range(SIMD_WIDTH)]
_BLEND = [
    k if k % 4 < 3 else SIMD_WIDTH + k for k in range(SIMD_WIDTH)
]  # first three of a, fourth of b


@intrinsic
def velocity(typing, row, push, min_mass):
    """Convert momentum and mass of four nodes to velocity after `push`, and mass.

    A node whose mass is not above the minimum is at rest.

    Args:
        row: Momentum and mass of the nodes [kg m/s, kg].
        push: Velocity added to each node [m/s].
        min_mass: Minimum mass [kg].
    """

    def _codegen(context, builder, signature, arguments):
        row, push, min_mass = arguments
        mass = builder.shuffle_vector(row, row, _mask(_FOURTH))
        moved = builder.fadd(builder.fdiv(row, mass), push)
        heavy = builder.fcmp_ordered(">", mass, min_mass)
        moved = builder.select(heavy, moved, ir.Constant(row.type, [0.0] * SIMD_WIDTH))
        return builder.shuffle_vector(moved, row, _mask(_BLEND))

    return row(row, push, min_mass), _codegen


@intrinsic
def fourth_of(typing, row):
    """Broadcast the fourth number of each node to all its lanes: xyzm -> mmmm."""

    def _codegen(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[0], _mask(_FOURTH))

    return row(row), _codegen


@intrinsic
def with_fourth(typing, row, other):
    """Return the vectors of a row with the fourth numbers of another."""

    def _codegen(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[1], _mask(_BLEND))

    return row(row, row), _codegen


@intrinsic
def squared(typing, row):
    """Return x^2 + y^2 + z^2 of each node in all its lanes."""

    def _codegen(context, builder, signature, arguments):
        square = builder.fmul(arguments[0], arguments[0])
        x, y, z = (
            builder.shuffle_vector(
                square, square, _mask([4 * (k // 4) + c for k in range(SIMD_WIDTH)])
            )
            for c in range(3)
        )
        return builder.fadd(builder.fadd(x, y), z)

    return row(row), _codegen
