"""Rows of four nodes as vectors: xyzm xyzm xyzm xyzm, a vector and a fourth number per node."""

from llvmlite import ir
from numba.extending import intrinsic

from .lanes import COUNT
from .rows import _mask

_FOURTH = [4 * (k // 4) + 3 for k in range(COUNT)]
_BLEND = [k if k % 4 < 3 else COUNT + k for k in range(COUNT)]  # first three of a, fourth of b


@intrinsic
def velocity(typing, row, push, least):
    """Momentum and mass of a row's four nodes -> velocity after `push`, and mass.

    A node whose mass is not above `least` is at rest.
    """

    def build(context, builder, signature, arguments):
        row, push, least = arguments
        mass = builder.shuffle_vector(row, row, _mask(_FOURTH))
        moved = builder.fadd(builder.fdiv(row, mass), push)
        heavy = builder.fcmp_ordered(">", mass, least)
        moved = builder.select(heavy, moved, ir.Constant(row.type, [0.0] * COUNT))
        return builder.shuffle_vector(moved, row, _mask(_BLEND))

    return row(row, push, least), build


@intrinsic
def fourth_of(typing, row):
    """xyzm -> mmmm: the fourth number of each node in all its lanes."""

    def build(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[0], _mask(_FOURTH))

    return row(row), build


@intrinsic
def with_fourth(typing, row, other):
    """The vectors of a row with the fourth numbers of another."""

    def build(context, builder, signature, arguments):
        return builder.shuffle_vector(arguments[0], arguments[1], _mask(_BLEND))

    return row(row, row), build


@intrinsic
def squared(typing, row):
    """x^2 + y^2 + z^2 of each node in all its lanes."""

    def build(context, builder, signature, arguments):
        square = builder.fmul(arguments[0], arguments[0])
        x, y, z = (
            builder.shuffle_vector(square, square, _mask([4 * (k // 4) + c for k in range(COUNT)]))
            for c in range(3)
        )
        return builder.fadd(builder.fadd(x, y), z)

    return row(row), build
