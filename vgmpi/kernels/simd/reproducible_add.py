"""Reproducible addition of numbers to doubles, in any order; see kernels/reproducible_sums.py."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .vector16 import DOUBLES, SIMD_WIDTH, VECTOR_OF, address

BLOCK = 256  # sums of a node block; sums of a second word follow, if there is one
ROOM = 6.0  # a sum may differ from its bias by bias / ROOM: 2^50 quanta, so partial sums fit
_TIES = 1.0 + 2.0**-52


def _fused(builder, kind, x, s):
    """Emit x (1 + 2^-52) + s, rounded once."""
    name = f"llvm.fma.v{kind.count}f64"
    target = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind] * 3), name)
    return builder.call(target, [x, ir.Constant(kind, [_TIES] * kind.count), s])


def _pointer(builder, start, kind, step):
    """Emit the pointer `step` numbers after a place, as a pointer to another type."""
    return builder.bitcast(
        builder.gep(start, [ir.Constant(ir.IntType(64), step)]), kind.as_pointer()
    )


def _add(widths):
    """Return the typing function that adds numbers of a patch, in vectors of `widths`."""

    def _typing_function(typing, sums, first, patch, source):
        single = VECTOR_OF[patch.dtype].real.bitwidth == 32

        def _codegen(context, builder, signature, arguments):
            target = address(context, builder, signature.args[0], *arguments[:2])
            source = address(context, builder, signature.args[2], *arguments[2:])
            offset = 0
            for n in widths:
                wide_type = ir.VectorType(ir.DoubleType(), n)
                narrow_type = ir.VectorType(VECTOR_OF[patch.dtype].vector.element, n)
                x = builder.load(
                    _pointer(builder, source, narrow_type, offset), align=4 if single else 8
                )
                x = builder.fpext(x, wide_type) if single else x
                pointer = _pointer(builder, target, wide_type, offset)
                old = builder.load(pointer, align=8)
                new = _fused(builder, wide_type, x, old)
                builder.store(new, pointer, align=8)
                if not single:
                    remainder = builder.fsub(x, builder.fsub(new, old))
                    pointer = _pointer(builder, target, wide_type, offset + BLOCK)
                    old = builder.load(pointer, align=8)
                    builder.store(_fused(builder, wide_type, remainder, old), pointer, align=8)
                offset += n
            return context.get_dummy_value()

        return types.void(sums, types.intp, patch, types.intp), _codegen

    return _typing_function


@intrinsic
def add_node(typing, sums, first, patch, source):
    """Add one node of a patch, four numbers, to sums.

    Args:
        sums: Sums of the nodal field (in/out).
        first: Index of the first sum.
        patch: Values of the patch.
        source: Index of the first value.
    """
    return _add((4,))(typing, sums, first, patch, source)


@intrinsic
def add_three(typing, sums, first, patch, source):
    """Add three nodes along z of a patch to sums; see `add_node`.

    Args:
        sums: Sums of the nodal field (in/out).
        first: Index of the first sum.
        patch: Values of the patch.
        source: Index of the first value.
    """
    return _add((8, 4))(typing, sums, first, patch, source)


@intrinsic
def add_row(typing, sums, first, patch, source):
    """Add four nodes along z of a patch to sums; see `add_node`.

    Args:
        sums: Sums of the nodal field (in/out).
        first: Index of the first sum.
        patch: Values of the patch.
        source: Index of the first value.
    """
    return _add((16,))(typing, sums, first, patch, source)


@intrinsic
def to_working_precision(typing, wide, example):
    """Convert 16 doubles to the precision of `example`."""
    lanes = VECTOR_OF[example.dtype]

    def _codegen(context, builder, signature, arguments):
        if lanes.real.bitwidth == 64:
            return arguments[0]
        return builder.fptrunc(arguments[0], lanes.vector)

    return lanes(wide, example), _codegen


@intrinsic
def overflow_mask(typing, value, bias):
    """Return bits of 16 sums that left their range or are NaN; value: sums minus their bias."""

    def _codegen(context, builder, signature, arguments):
        value, bias = arguments
        limit = builder.fmul(bias, DOUBLES.constant(1.0 / ROOM))
        prototype = ir.FunctionType(DOUBLES.vector, [DOUBLES.vector])
        magnitude = builder.call(
            cgutils.get_or_insert_function(
                builder.module, prototype, f"llvm.fabs.v{SIMD_WIDTH}f64"
            ),
            [value],
        )
        bad = builder.fcmp_unordered(">=", magnitude, limit)
        return builder.zext(builder.bitcast(bad, ir.IntType(SIMD_WIDTH)), ir.IntType(64))

    return types.int64(value, bias), _codegen


@intrinsic
def words_of(typing, example):
    """Return the number of words of a sum, known when code is compiled."""
    count = 1 if VECTOR_OF[example.dtype].real.bitwidth == 32 else 2

    def _codegen(context, builder, signature, arguments):
        return ir.Constant(ir.IntType(64), count)

    return types.intp(example), _codegen


_BITS = 52  # bits of a sum besides its sign and exponent, which equal those of its bias
_FOUR = ir.VectorType(ir.IntType(64), 4)


def _integers(*numbers):
    """Return the LLVM constant of four integers."""
    return ir.Constant(_FOUR, list(numbers))


@intrinsic
def pack_node(typing, to, index, tails, n, sums, node):
    """Pack four sums as 3 x 64 and 16 bits: three times 52 bits, each with a part of the fourth.

    Args:
        to, index: Message array (out) and index of the first number.
        tails, n: Array of the 16-bit tails (out) and index.
        sums, node: Sums, and index of the first of the four.
    """

    def _codegen(context, builder, signature, arguments):
        to, index, tails, n, sums, node = arguments
        v = builder.load(_pointer(builder, builder.gep(sums, [node]), _FOUR, 0), align=8)
        v = builder.and_(v, _integers(*[2**_BITS - 1] * 4))
        last = builder.shuffle_vector(v, v, ir.Constant(ir.VectorType(ir.IntType(32), 4), [3] * 4))
        last = builder.lshr(last, _integers(0, 12, 24, 36))
        more = builder.shl(last, _integers(_BITS, _BITS, _BITS, 0))
        out = builder.or_(v, more)
        for lane in range(3):
            number = builder.extract_element(out, ir.Constant(ir.IntType(32), lane))
            pointer = builder.gep(to, [builder.add(index, ir.Constant(index.type, lane))])
            builder.store(number, pointer, align=8)
        tail = builder.extract_element(last, ir.Constant(ir.IntType(32), 3))
        builder.store(builder.trunc(tail, ir.IntType(16)), builder.gep(tails, [n]), align=2)
        return context.get_dummy_value()

    return types.void(to, types.intp, tails, types.intp, sums, types.intp), _codegen


@intrinsic
def unpack_node(typing, sums, node, numbers, index, tails, n, bias, r):
    """Add four sums that `pack_node` packed, minus their bias.

    Args:
        sums, node: Sums (in/out), and index of the first of the four.
        numbers, index: Message array and index of the first number.
        tails, n: Array of the 16-bit tails and index.
        bias, r: Bias array and index.
    """

    def _codegen(context, builder, signature, arguments):
        sums, node, numbers, index, tails, n, bias, r = arguments
        doubles = ir.VectorType(ir.DoubleType(), 4)
        # The fourth number belongs to another node, or to the tails.
        v = builder.load(_pointer(builder, builder.gep(numbers, [index]), _FOUR, 0), align=8)
        parts = builder.shl(builder.lshr(v, _integers(*[_BITS] * 4)), _integers(0, 12, 24, 0))
        last = builder.zext(builder.load(builder.gep(tails, [n]), align=2), ir.IntType(64))
        last = builder.shl(last, ir.Constant(last.type, 36))
        for lane in range(3):
            part = builder.extract_element(parts, ir.Constant(ir.IntType(32), lane))
            last = builder.or_(last, part)
        v = builder.insert_element(v, last, ir.Constant(ir.IntType(32), 3))
        bias_value = builder.load(_pointer(builder, builder.gep(bias, [r]), doubles, 0), align=8)
        sign = builder.and_(builder.bitcast(bias_value, _FOUR), _integers(*[-(2**_BITS)] * 4))
        v = builder.or_(builder.and_(v, _integers(*[2**_BITS - 1] * 4)), sign)
        more = builder.fsub(builder.bitcast(v, doubles), bias_value)
        pointer = _pointer(builder, builder.gep(sums, [node]), doubles, 0)
        builder.store(builder.fadd(builder.load(pointer, align=8), more), pointer, align=8)
        return context.get_dummy_value()

    arguments = (sums, types.intp, numbers, types.intp, tails, types.intp, bias, types.intp)
    return types.void(*arguments), _codegen


@intrinsic
def lowest(typing, mask):
    """Return the index of the lowest bit that is set; mask is not 0."""

    def _codegen(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), _codegen
