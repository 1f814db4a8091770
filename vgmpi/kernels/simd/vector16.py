"""SIMD vector type of 16 particles for compiled code, in single or double precision.

The material laws, written once as scalar formulas, run on 16 particles at a time: operators,
comparisons, `select` and (math_functions.py) the NumPy functions they use are defined for vectors,
and plain numbers in a formula are broadcast to all lanes. Masks tell which particles of a vector
are in range. Segments begin at multiples of 16, so a vector never straddles two of them. A
processor without 512-bit registers takes several instructions for one vector operation; the
formulas are the same.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import FP_CONTRACTION, overload

SIMD_WIDTH = 16
LINE = 64  # [bytes] cache line
# A product and a sum may round once; all ranks run the same code.
_FUSED = ("contract",) if FP_CONTRACTION else ()
_I32 = ir.IntType(32)
ALL_LANES = np.int64((1 << SIMD_WIDTH) - 1)


class VectorType(types.Type):
    """Vector of 16 numbers of a numba float type.

    It is shorter where a row of nodes is processed in parts (partial_rows.py).
    """

    def __init__(self, real: types.Float, count: int = SIMD_WIDTH):
        self.real = real
        self.count = count
        scalar = ir.FloatType() if real.bitwidth == 32 else ir.DoubleType()
        self.vector = ir.VectorType(scalar, self.count)
        self.integer_vector = ir.VectorType(ir.IntType(real.bitwidth), self.count)
        super().__init__(name=f"Lanes({real} x {self.count})")

    def constant(self, value: float) -> ir.Constant:
        """Return the LLVM constant with a number in all lanes."""
        return ir.Constant(self.vector, [value] * self.count)

    def integer(self, value: int) -> ir.Constant:
        """Return the LLVM constant with an integer in all lanes."""
        return ir.Constant(self.integer_vector, [value] * self.count)


class MaskType(types.Type):
    """Vector of 16 truth values, the result of a comparison."""

    def __init__(self, lanes: VectorType):
        self.lanes = lanes
        self.vector = ir.VectorType(ir.IntType(1), lanes.count)
        super().__init__(name=f"Mask({lanes})")


FLOATS, DOUBLES = VectorType(types.float32), VectorType(types.float64)
VECTOR_OF = {types.float32: FLOATS, types.float64: DOUBLES}


@register_model(VectorType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, lanes.vector)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, mask):
        super().__init__(manager, mask, mask.vector)


def broadcast_value(context, builder, kind, lanes, value):
    """Emit a vector, or a plain number broadcast to all lanes.

    Args:
        context, builder: numba's target context and LLVM builder.
        kind: numba type of the value.
        lanes: Vector type.
        value: LLVM value.
    """
    if isinstance(kind, VectorType):
        return value
    number = context.cast(builder, value, kind, lanes.real)
    vector = builder.insert_element(
        ir.Constant(lanes.vector, ir.Undefined), number, ir.Constant(ir.IntType(32), 0)
    )
    zero = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(vector, vector, zero)


def address(context, builder, array_type, array, index):
    """Emit the pointer to an element of a contiguous array, or behind a `pointer`.

    Args:
        context, builder: numba's target context and LLVM builder.
        array_type, array: numba type and LLVM value of the one-dimensional array.
        index: LLVM value of the index.
    """
    if isinstance(array_type, types.CPointer):
        return builder.gep(array, [index])
    data = cgutils.create_struct_proxy(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def pointer(typing, row):
    """Return the pointer to the first element of a contiguous array.

    It serves `load`, `store` and [] as the array does. Passing the array itself costs as much as
    the arithmetic of some rows, since it is reference-counted and takes seven registers; the
    pointer is one number. The caller must keep the array alive.
    """

    def _codegen(context, builder, signature, arguments):
        return cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(row.dtype)(row), _codegen


@intrinsic
def prefetch(typing, place, first):
    """Prefetch the 16 numbers from place[first] on; beyond the end of the array nothing happens."""

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments)
        pointer, word = builder.bitcast(pointer, ir.IntType(8).as_pointer()), ir.IntType(32)
        prototype = ir.FunctionType(ir.VoidType(), [pointer.type, word, word, word])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [pointer.type], prototype)
        for line in range(0, SIMD_WIDTH * place.dtype.bitwidth // 8, LINE):
            line_pointer = builder.gep(pointer, [ir.Constant(ir.IntType(64), line)])
            builder.call(fetch, [line_pointer, word(0), word(2), word(1)])
        return context.get_dummy_value()

    return types.void(place, first), _codegen


@intrinsic
def load(typing, row, first):
    """Load row[first], row[first + 1], ... of a contiguous array as one vector."""
    lanes = VECTOR_OF[row.dtype]

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments)
        pointer = builder.bitcast(pointer, lanes.vector.as_pointer())
        return builder.load(pointer, align=lanes.real.bitwidth // 8)

    return lanes(row, types.intp), _codegen


@intrinsic
def load_wide(typing, row, first):
    """Load row[first], row[first + 1], ... of a contiguous array as one vector of doubles."""
    lanes = VECTOR_OF[row.dtype]

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments)
        pointer = builder.bitcast(pointer, lanes.vector.as_pointer())
        values = builder.load(pointer, align=lanes.real.bitwidth // 8)
        return values if lanes is DOUBLES else builder.fpext(values, DOUBLES.vector)

    return DOUBLES(row, types.intp), _codegen


@intrinsic
def store(typing, row, first, values):
    """Store a vector to row[first], row[first + 1], ...

    Args:
        row: Contiguous array (out).
        first: Index of the first element.
        values: Vector or number.
    """
    lanes = VECTOR_OF[row.dtype]

    def _codegen(context, builder, signature, arguments):
        pointer = address(context, builder, signature.args[0], *arguments[:2])
        pointer = builder.bitcast(pointer, lanes.vector.as_pointer())
        vector = broadcast_value(context, builder, signature.args[2], lanes, arguments[2])
        builder.store(vector, pointer, align=lanes.real.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(row, types.intp, values), _codegen


_PLAIN = types.Float | types.Integer | types.Boolean


def _lanes_of(*operands) -> VectorType | None:
    """Return the vector type of an operation, None for operands of other types."""
    vectors = {g for g in operands if isinstance(g, VectorType)}
    plain = all(isinstance(g, VectorType | _PLAIN) for g in operands)
    return vectors.pop() if len(vectors) == 1 and plain else None


def binary(function, emit, result=lambda lanes: lanes):
    """Define `function` of two values, at least one of them a vector."""

    @intrinsic
    def _intrinsic(typing, a, b):
        lanes = _lanes_of(a, b)

        def _codegen(context, builder, signature, arguments):
            pair = zip(signature.args, arguments, strict=True)
            return emit(
                builder, lanes, *(broadcast_value(context, builder, t, lanes, v) for t, v in pair)
            )

        return result(lanes)(a, b), _codegen

    @overload(function)
    def _overload(a, b):
        if _lanes_of(a, b) is not None:
            return lambda a, b: _intrinsic(a, b)


def unary(function, emit, operand=VectorType):
    """Define `function` of one vector, or of one mask."""

    @intrinsic
    def _intrinsic(typing, a):
        return a(a), lambda context, builder, signature, arguments: emit(builder, a, arguments[0])

    @overload(function)
    def _overload(a):
        if isinstance(a, operand):
            return lambda a: _intrinsic(a)


def call(name):
    """Return an emitter of calls to an LLVM vector function, such as llvm.fabs."""

    def _emit(builder, lanes, *values):
        kind = f"v{lanes.count}f{lanes.real.bitwidth}"
        signature = ir.FunctionType(lanes.vector, [lanes.vector] * len(values))
        target = cgutils.get_or_insert_function(builder.module, signature, f"{name}.{kind}")
        return builder.call(target, values)

    return _emit


def _plain(instruction):
    """Return the emitter of a floating-point instruction."""
    return lambda builder, lanes, a, b: getattr(builder, instruction)(a, b, flags=_FUSED)


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    binary(_operator, _plain(_instruction))


def _highest(builder, lanes, a, b):
    """Emit the larger number; NaN wins, as in NumPy."""
    return _propagate_nan(builder, a, b, builder.select(builder.fcmp_ordered(">", a, b), a, b))


def _lowest(builder, lanes, a, b):
    """Emit the smaller number; NaN wins, as in NumPy."""
    return _propagate_nan(builder, a, b, builder.select(builder.fcmp_ordered("<", a, b), a, b))


def _propagate_nan(builder, a, b, chosen):
    """Emit `chosen`, which is b if either is NaN, or a if a is NaN.

    NumPy returns the operand that is NaN.
    """
    return builder.select(builder.fcmp_unordered("uno", a, a), a, chosen)


binary(np.maximum, _highest)
binary(np.minimum, _lowest)
binary(np.copysign, call("llvm.copysign"))
unary(operator.neg, lambda builder, lanes, a: builder.fsub(lanes.constant(-0.0), a))
unary(operator.pos, lambda builder, lanes, a: a)
unary(abs, call("llvm.fabs"))
unary(np.abs, call("llvm.fabs"))
unary(np.sqrt, call("llvm.sqrt"))
unary(np.floor, call("llvm.floor"))


@infer_global(operator.pow)
class _Power(AbstractTemplate):
    """Type inference of a vector to an integer power."""

    def generic(self, args, kws):
        """Return the signature of vector ** integer literal."""
        base, n = args
        if isinstance(base, VectorType) and isinstance(n, types.IntegerLiteral):
            return signature(base, base, n)


@lower_builtin(operator.pow, VectorType, types.IntegerLiteral)
def _power(context, builder, sig, args):
    """Emit x**n for an integer literal n, by squaring; a real n needs exp(n log x)."""
    lanes, n = sig.args[0], sig.args[1].literal_value
    square, total, left = args[0], None, abs(n)
    while left:
        if left & 1:
            total = square if total is None else builder.fmul(total, square)
        left >>= 1
        if left:
            square = builder.fmul(square, square)
    unit = lanes.constant(1.0)
    total = unit if total is None else total
    return builder.fdiv(unit, total) if n < 0 else total


# ---- comparisons --------------------------------------------------------------------------------


def _compare(sign):
    """Return the emitter of a comparison."""
    # NaN only satisfies !=.
    name = "fcmp_unordered" if sign == "!=" else "fcmp_ordered"
    return lambda builder, lanes, a, b: getattr(builder, name)(sign, a, b)


for _operator, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    binary(_operator, _compare(_sign), MaskType)


def _truths(builder, kind, value):
    """Emit 16 truth values; a plain one holds for all lanes."""
    if isinstance(kind, MaskType):
        return value
    vector = ir.VectorType(ir.IntType(1), SIMD_WIDTH)
    return builder.select(
        value, ir.Constant(vector, [1] * SIMD_WIDTH), ir.Constant(vector, [0] * SIMD_WIDTH)
    )


def _mask_of(*operands) -> MaskType | None:
    """Return the mask type of an operation, None for operands of other types."""
    masks = {g for g in operands if isinstance(g, MaskType)}
    plain = all(isinstance(g, MaskType | types.Boolean) for g in operands)
    return masks.pop() if len(masks) == 1 and plain else None


def _join(function, instruction):
    """Define `function` of two conditions, at least one of them a mask."""

    @intrinsic
    def _intrinsic(typing, a, b):
        def _codegen(context, builder, signature, arguments):
            pair = zip(signature.args, arguments, strict=True)
            return getattr(builder, instruction)(*(_truths(builder, t, v) for t, v in pair))

        return _mask_of(a, b)(a, b), _codegen

    @overload(function)
    def _overload(a, b):
        if _mask_of(a, b) is not None:
            return lambda a, b: _intrinsic(a, b)


for _operator, _instruction in (
    (operator.and_, "and_"),
    (np.logical_and, "and_"),
    (operator.or_, "or_"),
    (np.logical_or, "or_"),
    (operator.xor, "xor"),
):
    _join(_operator, _instruction)


def _not(builder, mask, a):
    return builder.not_(a)


unary(operator.invert, _not, MaskType)
unary(np.logical_not, _not, MaskType)


@intrinsic
def _blend(typing, mask, a, b):
    lanes = _lanes_of(a, b) or mask.lanes

    def _codegen(context, builder, signature, arguments):
        operands = zip(signature.args[1:], arguments[1:], strict=True)
        a, b = (broadcast_value(context, builder, t, lanes, v) for t, v in operands)
        return builder.select(arguments[0], a, b)

    return lanes(mask, a, b), _codegen


@overload(select)
def _select(mask, a, b):
    if isinstance(mask, types.Boolean) and isinstance(a, _PLAIN) and isinstance(b, _PLAIN):
        return lambda mask, a, b: a if mask else b
    if isinstance(mask, MaskType) or _lanes_of(a, b) is not None:
        return lambda mask, a, b: _blend(mask, a, b)


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
