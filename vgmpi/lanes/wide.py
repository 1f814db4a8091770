"""Doubles that numbers are added to in any order: see kernels/sums.py."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .lanes import COUNT, DOUBLES, OF, address

BLOCK = 256  # sums of a node block; behind them, if any, those of the second word
ROOM = 12.0  # a sum may leave rest by this part of it: 2^49 quanta, so that partial sums have room
_TIES = 1.0 + 2.0**-52


def _fused(builder, kind, x, s):
    """x (1 + 2^-52) + s, rounded once."""
    name = f"llvm.fma.v{kind.count}f64"
    target = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind] * 3), name)
    return builder.call(target, [x, ir.Constant(kind, [_TIES] * kind.count), s])


def _pointer(builder, place, kind, step):
    return builder.bitcast(
        builder.gep(place, [ir.Constant(ir.IntType(64), step)]), kind.as_pointer()
    )


def _add(widths):
    """Add numbers of a patch to sums, in vectors of `widths` one after the other."""

    def make(typing, sums, first, patch, of):
        single = OF[patch.dtype].real.bitwidth == 32

        def build(context, builder, signature, arguments):
            to = address(context, builder, signature.args[0], *arguments[:2])
            of = address(context, builder, signature.args[2], *arguments[2:])
            at = 0
            for n in widths:
                wide = ir.VectorType(ir.DoubleType(), n)
                given = ir.VectorType(OF[patch.dtype].vector.element, n)
                x = builder.load(_pointer(builder, of, given, at), align=4 if single else 8)
                x = builder.fpext(x, wide) if single else x
                here = _pointer(builder, to, wide, at)
                old = builder.load(here, align=8)
                new = _fused(builder, wide, x, old)
                builder.store(new, here, align=8)
                if not single:
                    left = builder.fsub(x, builder.fsub(new, old))
                    here = _pointer(builder, to, wide, at + BLOCK)
                    old = builder.load(here, align=8)
                    builder.store(_fused(builder, wide, left, old), here, align=8)
                at += n
            return context.get_dummy_value()

        return types.void(sums, types.intp, patch, types.intp), build

    return make


@intrinsic
def add_node(typing, sums, first, patch, of):
    """Add one node of a patch, four numbers from patch[of] on, to the sums from `first` on."""
    return _add((4,))(typing, sums, first, patch, of)


@intrinsic
def add_three(typing, sums, first, patch, of):
    """As `add_node`, three nodes along z."""
    return _add((8, 4))(typing, sums, first, patch, of)


@intrinsic
def add_row(typing, sums, first, patch, of):
    """As `add_node`, four nodes along z."""
    return _add((16,))(typing, sums, first, patch, of)


@intrinsic
def narrow(typing, wide, example):
    """16 doubles in the precision of `example`."""
    lanes = OF[example.dtype]

    def build(context, builder, signature, arguments):
        if lanes.real.bitwidth == 64:
            return arguments[0]
        return builder.fptrunc(arguments[0], lanes.vector)

    return lanes(wide, example), build


@intrinsic
def beyond(typing, value, rest):
    """Bits of those of 16 sums that left their range, or are no numbers. value: less rest."""

    def build(context, builder, signature, arguments):
        value, rest = arguments
        most = builder.fmul(rest, DOUBLES.constant(1.0 / ROOM))
        kind = ir.FunctionType(DOUBLES.vector, [DOUBLES.vector])
        size = builder.call(
            cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{COUNT}f64"), [value]
        )
        bad = builder.fcmp_unordered(">=", size, most)
        return builder.zext(builder.bitcast(bad, ir.IntType(COUNT)), ir.IntType(64))

    return types.int64(value, rest), build


@intrinsic
def words_of(typing, example):
    """`words` of an array's precision, known when code is compiled."""
    count = 1 if OF[example.dtype].real.bitwidth == 32 else 2

    def build(context, builder, signature, arguments):
        return ir.Constant(ir.IntType(64), count)

    return types.intp(example), build


@intrinsic
def copy(typing, to, first, of, at):
    """to[first:first + 4] = of[at:at + 4]."""

    def build(context, builder, signature, arguments):
        kind = ir.VectorType(ir.DoubleType(), 4)
        a = address(context, builder, signature.args[0], *arguments[:2])
        b = address(context, builder, signature.args[2], *arguments[2:])
        value = builder.load(_pointer(builder, b, kind, 0), align=8)
        builder.store(value, _pointer(builder, a, kind, 0), align=8)
        return context.get_dummy_value()

    return types.void(to, types.intp, of, types.intp), build


@intrinsic
def take(typing, to, first, of, at, rest, r):
    """to[first:first + 4] += of[at:at + 4] - rest[r:r + 4]."""

    def build(context, builder, signature, arguments):
        kind = ir.VectorType(ir.DoubleType(), 4)
        a = address(context, builder, signature.args[0], *arguments[:2])
        b = address(context, builder, signature.args[2], *arguments[2:4])
        c = address(context, builder, signature.args[4], *arguments[4:])
        a, b, c = (_pointer(builder, p, kind, 0) for p in (a, b, c))
        more = builder.fsub(builder.load(b, align=8), builder.load(c, align=8))
        builder.store(builder.fadd(builder.load(a, align=8), more), a, align=8)
        return context.get_dummy_value()

    return types.void(to, types.intp, of, types.intp, rest, types.intp), build


@intrinsic
def lowest(typing, mask):
    """Number of the lowest bit that is set; mask is not 0."""

    def build(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), build
