"""Doubles that numbers are added to in any order: see kernels/sums.py."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .lanes import COUNT, DOUBLES, OF, address

BLOCK = 256  # sums of a node block; behind them, if any, those of the second word
ROOM = 6.0  # a sum may leave rest by this part of it: 2^50 quanta, so that partial sums have room
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


_BITS = 52  # of a sum beside its sign and exponent, which are those of what it rests at
_FOUR = ir.VectorType(ir.IntType(64), 4)


def _each(*numbers):
    return ir.Constant(_FOUR, list(numbers))


@intrinsic
def pack_node(typing, to, at, tails, n, of, node):
    """Four sums of[node ...] as 3 x 64 bits to to[at ...] and 16 bits to tails[n]: three times 52
    bits, and behind each, and in the tail, a part of the fourth."""

    def build(context, builder, signature, arguments):
        to, at, tails, n, of, node = arguments
        v = builder.load(_pointer(builder, builder.gep(of, [node]), _FOUR, 0), align=8)
        v = builder.and_(v, _each(*[2**_BITS - 1] * 4))
        last = builder.shuffle_vector(v, v, ir.Constant(ir.VectorType(ir.IntType(32), 4), [3] * 4))
        last = builder.lshr(last, _each(0, 12, 24, 36))
        more = builder.shl(last, _each(_BITS, _BITS, _BITS, 0))
        out = builder.or_(v, more)
        for lane in range(3):
            number = builder.extract_element(out, ir.Constant(ir.IntType(32), lane))
            place = builder.gep(to, [builder.add(at, ir.Constant(at.type, lane))])
            builder.store(number, place, align=8)
        tail = builder.extract_element(last, ir.Constant(ir.IntType(32), 3))
        builder.store(builder.trunc(tail, ir.IntType(16)), builder.gep(tails, [n]), align=2)
        return context.get_dummy_value()

    return types.void(to, types.intp, tails, types.intp, of, types.intp), build


@intrinsic
def unpack_node(typing, sums, node, of, at, tails, n, rest, r):
    """sums[node ...] += what `pack_node` packed, less rest[r ...]: four sums."""

    def build(context, builder, signature, arguments):
        sums, node, of, at, tails, n, rest, r = arguments
        doubles = ir.VectorType(ir.DoubleType(), 4)
        # the fourth number is another's, or the first tails
        v = builder.load(_pointer(builder, builder.gep(of, [at]), _FOUR, 0), align=8)
        parts = builder.shl(builder.lshr(v, _each(*[_BITS] * 4)), _each(0, 12, 24, 0))
        last = builder.zext(builder.load(builder.gep(tails, [n]), align=2), ir.IntType(64))
        last = builder.shl(last, ir.Constant(last.type, 36))
        for lane in range(3):
            part = builder.extract_element(parts, ir.Constant(ir.IntType(32), lane))
            last = builder.or_(last, part)
        v = builder.insert_element(v, last, ir.Constant(ir.IntType(32), 3))
        at_rest = builder.load(_pointer(builder, builder.gep(rest, [r]), doubles, 0), align=8)
        sign = builder.and_(builder.bitcast(at_rest, _FOUR), _each(*[-(2**_BITS)] * 4))
        v = builder.or_(builder.and_(v, _each(*[2**_BITS - 1] * 4)), sign)
        more = builder.fsub(builder.bitcast(v, doubles), at_rest)
        place = _pointer(builder, builder.gep(sums, [node]), doubles, 0)
        builder.store(builder.fadd(builder.load(place, align=8), more), place, align=8)
        return context.get_dummy_value()

    arguments = (sums, types.intp, of, types.intp, tails, types.intp, rest, types.intp)
    return types.void(*arguments), build


@intrinsic
def lowest(typing, mask):
    """Number of the lowest bit that is set; mask is not 0."""

    def build(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), build
