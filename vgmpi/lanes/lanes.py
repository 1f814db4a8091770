"""Vectors of 16 particles as a value type for compiled code, in single or double precision.

With it the laws, written once as scalar formulas, run on 16 particles at a time: operators,
comparisons, `select` and (functions.py) the numpy functions they use are defined for lanes, and
plain numbers in a formula are spread to all lanes. Segments begin at multiples of 16, so a vector
never straddles two of them. A processor without 512-bit registers takes several instructions for
one; the formulas are the same.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

from ..device.jit import CONTRACTS
from ..device.select import select

COUNT = 16
LINE = 64  # bytes of a cache line
# a product and a sum may round once; the same code serves all ranks
_FUSED = ("contract",) if CONTRACTS else ()


class Lanes(types.Type):
    """A vector of 16 numbers of a numba float type; of fewer where a row of nodes is taken in parts
    (rows.py)."""

    def __init__(self, real: types.Float, count: int = COUNT):
        self.real = real
        self.count = count
        scalar = ir.FloatType() if real.bitwidth == 32 else ir.DoubleType()
        self.vector = ir.VectorType(scalar, self.count)
        self.whole = ir.VectorType(ir.IntType(real.bitwidth), self.count)
        super().__init__(name=f"Lanes({real} x {self.count})")

    def constant(self, value: float) -> ir.Constant:
        return ir.Constant(self.vector, [value] * self.count)

    def integer(self, value: int) -> ir.Constant:
        return ir.Constant(self.whole, [value] * self.count)


class Mask(types.Type):
    """16 truth values, of a comparison of lanes."""

    def __init__(self, lanes: Lanes):
        self.lanes = lanes
        self.vector = ir.VectorType(ir.IntType(1), lanes.count)
        super().__init__(name=f"Mask({lanes})")


FLOATS, DOUBLES = Lanes(types.float32), Lanes(types.float64)
OF = {types.float32: FLOATS, types.float64: DOUBLES}


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, lanes.vector)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, mask):
        super().__init__(manager, mask, mask.vector)


def in_all_lanes(context, builder, given, lanes, value):
    """A vector, or a plain number in all lanes."""
    if isinstance(given, Lanes):
        return value
    number = context.cast(builder, value, given, lanes.real)
    one = builder.insert_element(
        ir.Constant(lanes.vector, ir.Undefined), number, ir.Constant(ir.IntType(32), 0)
    )
    zero = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(one, one, zero)


def address(context, builder, array_type, array, index):
    """Pointer to an element of a contiguous one-dimensional array, or behind a `place`."""
    if isinstance(array_type, types.CPointer):
        return builder.gep(array, [index])
    data = cgutils.create_struct_proxy(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def place(typing, row):
    """Where a contiguous array begins: serves `load`, `store` and [] as the array does.

    To hand an array on costs as much as the arithmetic of some rows, since it is counted and takes
    seven registers; this is one number. The array itself must be kept alive by the caller.
    """

    def build(context, builder, signature, arguments):
        return cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(row.dtype)(row), build


@intrinsic
def ahead(typing, place, first):
    """Begin to fetch the 16 numbers from place[first] on into a nearer cache; beyond the end of the
    array nothing happens."""

    def build(context, builder, signature, arguments):
        at = address(context, builder, signature.args[0], *arguments)
        at, word = builder.bitcast(at, ir.IntType(8).as_pointer()), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [at.type, word, word, word])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [at.type], kind)
        for line in range(0, COUNT * OF[place.dtype].real.bitwidth // 8, LINE):
            here = builder.gep(at, [ir.Constant(ir.IntType(64), line)])
            builder.call(fetch, [here, word(0), word(2), word(1)])
        return context.get_dummy_value()

    return types.void(place, first), build


@intrinsic
def load(typing, row, first):
    """The numbers row[first], row[first + 1], ... of a contiguous array as one vector."""
    lanes = OF[row.dtype]

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments)
        place = builder.bitcast(place, lanes.vector.as_pointer())
        return builder.load(place, align=lanes.real.bitwidth // 8)

    return lanes(row, types.intp), build


@intrinsic
def store(typing, row, first, values):
    """Put a vector to row[first], row[first + 1], ..."""
    lanes = OF[row.dtype]

    def build(context, builder, signature, arguments):
        place = address(context, builder, signature.args[0], *arguments[:2])
        place = builder.bitcast(place, lanes.vector.as_pointer())
        vector = in_all_lanes(context, builder, signature.args[2], lanes, arguments[2])
        builder.store(vector, place, align=lanes.real.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(row, types.intp, values), build


_PLAIN = types.Float | types.Integer | types.Boolean


def _lanes_of(*given) -> Lanes | None:
    """The vector type of an operation; None if it is not ours."""
    found = {g for g in given if isinstance(g, Lanes)}
    plain = all(isinstance(g, Lanes | _PLAIN) for g in given)
    return found.pop() if len(found) == 1 and plain else None


def binary(function, emit, result=lambda lanes: lanes):
    """Define `function` of two values, at least one of them a vector."""

    @intrinsic
    def go(typing, a, b):
        lanes = _lanes_of(a, b)

        def build(context, builder, signature, arguments):
            pair = zip(signature.args, arguments, strict=True)
            return emit(
                builder, lanes, *(in_all_lanes(context, builder, t, lanes, v) for t, v in pair)
            )

        return result(lanes)(a, b), build

    @overload(function, strict=False)
    def choose(a, b):
        if _lanes_of(a, b) is not None:
            return lambda a, b: go(a, b)


def unary(function, emit, of=Lanes):
    """Define `function` of one vector, or of one mask."""

    @intrinsic
    def go(typing, a):
        return a(a), lambda context, builder, signature, arguments: emit(builder, a, arguments[0])

    @overload(function, strict=False)
    def choose(a):
        if isinstance(a, of):
            return lambda a: go(a)


def call(name):
    """Emit a call of an LLVM function of vectors, such as llvm.fabs."""

    def emit(builder, lanes, *values):
        kind = f"v{lanes.count}f{lanes.real.bitwidth}"
        signature = ir.FunctionType(lanes.vector, [lanes.vector] * len(values))
        target = cgutils.get_or_insert_function(builder.module, signature, f"{name}.{kind}")
        return builder.call(target, values)

    return emit


def _plain(instruction):
    return lambda builder, lanes, a, b: getattr(builder, instruction)(a, b, flags=_FUSED)


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    binary(_operator, _plain(_instruction))


def _highest(builder, lanes, a, b):
    return _not_a_number_wins(builder, a, b, builder.select(builder.fcmp_ordered(">", a, b), a, b))


def _lowest(builder, lanes, a, b):
    return _not_a_number_wins(builder, a, b, builder.select(builder.fcmp_ordered("<", a, b), a, b))


def _not_a_number_wins(builder, a, b, chosen):
    """`chosen` is b where either is not a number; numpy returns the one that is not."""
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
    def generic(self, args, kws):
        base, n = args
        if isinstance(base, Lanes) and isinstance(n, types.IntegerLiteral):
            return signature(base, base, n)


@lower_builtin(operator.pow, Lanes, types.IntegerLiteral)
def _power(context, builder, sig, args):
    """x**n for a whole number written in the formula, by squaring; a real n: exp(n log x)."""
    lanes, n = sig.args[0], sig.args[1].literal_value
    square, total, left = args[0], None, abs(n)
    while left:
        if left & 1:
            total = square if total is None else builder.fmul(total, square)
        left >>= 1
        if left:
            square = builder.fmul(square, square)
    one = lanes.constant(1.0)
    total = one if total is None else total
    return builder.fdiv(one, total) if n < 0 else total


# ---- comparisons --------------------------------------------------------------------------------


def _compare(sign):
    # only != holds for what is not a number
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
    binary(_operator, _compare(_sign), Mask)


def _truths(builder, given, value):
    """16 truth values; a plain one counts for all."""
    if isinstance(given, Mask):
        return value
    kind = ir.VectorType(ir.IntType(1), COUNT)
    return builder.select(value, ir.Constant(kind, [1] * COUNT), ir.Constant(kind, [0] * COUNT))


def _mask_of(*given) -> Mask | None:
    found = {g for g in given if isinstance(g, Mask)}
    plain = all(isinstance(g, Mask | types.Boolean) for g in given)
    return found.pop() if len(found) == 1 and plain else None


def _join(function, instruction):
    """Define `function` of two conditions, at least one of them a mask."""

    @intrinsic
    def go(typing, a, b):
        def build(context, builder, signature, arguments):
            pair = zip(signature.args, arguments, strict=True)
            return getattr(builder, instruction)(*(_truths(builder, t, v) for t, v in pair))

        return _mask_of(a, b)(a, b), build

    @overload(function, strict=False)
    def choose(a, b):
        if _mask_of(a, b) is not None:
            return lambda a, b: go(a, b)


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


unary(operator.invert, _not, Mask)
unary(np.logical_not, _not, Mask)


@intrinsic
def _blend(typing, mask, a, b):
    lanes = _lanes_of(a, b) or mask.lanes

    def build(context, builder, signature, arguments):
        either = zip(signature.args[1:], arguments[1:], strict=True)
        a, b = (in_all_lanes(context, builder, t, lanes, v) for t, v in either)
        return builder.select(arguments[0], a, b)

    return lanes(mask, a, b), build


@overload(select, strict=False)
def _select(mask, a, b):
    if isinstance(mask, types.Boolean) and isinstance(a, _PLAIN) and isinstance(b, _PLAIN):
        return lambda mask, a, b: a if mask else b
    if isinstance(mask, Mask) or _lanes_of(a, b) is not None:
        return lambda mask, a, b: _blend(mask, a, b)
