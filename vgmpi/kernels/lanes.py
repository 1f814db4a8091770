"""Vectors of 16 particles as a value type for compiled code, in single or double precision.

With it the laws, written once as scalar formulas, run on 16 particles at a time: operators and the
numpy functions they use are defined for lanes, and plain numbers in a formula are spread to all
lanes. Segments begin at multiples of 16, so a vector never straddles two of them. A processor
without 512-bit registers takes several instructions for one; the formulas are the same.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

COUNT = 16
_FUSED = ("contract",)  # a product and a sum may round once; the same code serves all ranks


class Lanes(types.Type):
    """A vector of 16 numbers of a numba float type."""

    def __init__(self, real: types.Float):
        self.real = real
        self.count = COUNT
        scalar = ir.FloatType() if real.bitwidth == 32 else ir.DoubleType()
        self.vector = ir.VectorType(scalar, self.count)
        self.whole = ir.VectorType(ir.IntType(real.bitwidth), self.count)
        super().__init__(name=f"Lanes({real} x {self.count})")

    def constant(self, value: float) -> ir.Constant:
        return ir.Constant(self.vector, [value] * self.count)

    def integer(self, value: int) -> ir.Constant:
        return ir.Constant(self.whole, [value] * self.count)


FLOATS, DOUBLES = Lanes(types.float32), Lanes(types.float64)
OF = {types.float32: FLOATS, types.float64: DOUBLES}


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, lanes.vector)


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
    """Pointer to an element of a contiguous one-dimensional array."""
    data = cgutils.create_struct_proxy(array_type)(context, builder, array).data
    return builder.gep(data, [index])


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


def _lanes_of(*given) -> Lanes | None:
    """The vector type of an operation; None if it is not ours."""
    found = {g for g in given if isinstance(g, Lanes)}
    plain = all(isinstance(g, Lanes | types.Float | types.Integer | types.Boolean) for g in given)
    return found.pop() if len(found) == 1 and plain else None


def _binary(function, emit):
    """Define `function` of two values, at least one of them a vector."""

    @intrinsic
    def go(typing, a, b):
        lanes = _lanes_of(a, b)

        def build(context, builder, signature, arguments):
            pair = zip(signature.args, arguments, strict=True)
            return emit(
                builder, lanes, *(in_all_lanes(context, builder, t, lanes, v) for t, v in pair)
            )

        return lanes(a, b), build

    @overload(function, strict=False)
    def choose(a, b):
        if _lanes_of(a, b) is not None:
            return lambda a, b: go(a, b)


def _unary(function, emit):
    @intrinsic
    def go(typing, a):
        return a(a), lambda context, builder, signature, arguments: emit(builder, a, arguments[0])

    @overload(function, strict=False)
    def choose(a):
        if isinstance(a, Lanes):
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
    _binary(_operator, _plain(_instruction))

_binary(np.maximum, call("llvm.maxnum"))
_binary(np.minimum, call("llvm.minnum"))
_unary(operator.neg, lambda builder, lanes, a: builder.fsub(lanes.constant(-0.0), a))
_unary(operator.pos, lambda builder, lanes, a: a)
_unary(abs, call("llvm.fabs"))
_unary(np.abs, call("llvm.fabs"))
_unary(np.sqrt, call("llvm.sqrt"))


def _polynomial(builder, lanes, x, coefficients):
    """Horner's scheme; coefficients from the highest power down."""
    total = lanes.constant(coefficients[0])
    for c in coefficients[1:]:
        total = builder.fadd(builder.fmul(total, x), lanes.constant(c))
    return total


def _power_of_two(builder, lanes, k):
    """2^k for a vector of whole numbers k."""
    bias, width = (127, 23) if lanes.real.bitwidth == 32 else (1023, 52)
    whole = builder.add(builder.fptosi(k, lanes.whole), lanes.integer(bias))
    return builder.bitcast(builder.shl(whole, lanes.integer(width)), lanes.vector)


def _exponent_parts(builder, lanes, x):
    """exp(x) = 2^k (1 + q): (2^k, q) with q exact near 0. Beyond the range of numbers x is cut."""
    single = lanes.real.bitwidth == 32
    most = lanes.constant(87.0 if single else 708.0)
    x = call("llvm.minnum")(builder, lanes, x, most)
    x = call("llvm.maxnum")(builder, lanes, x, builder.fneg(most))
    # ln 2 in two parts, so that k times the first is exact
    double = (0.6931471803691238, 1.9082149292705877e-10)
    high, low = (0.693359375, -2.12194440e-4) if single else double
    k = call("llvm.rint")(builder, lanes, builder.fmul(x, lanes.constant(1.4426950408889634)))
    r = builder.fsub(x, builder.fmul(k, lanes.constant(high)))
    r = builder.fsub(r, builder.fmul(k, lanes.constant(low)))
    powers, factorial = [], 1.0
    for n in range(2, 9 if single else 15):
        factorial *= n
        powers.append(1.0 / factorial)
    # expm1(r) = r + r^2 (1/2 + r/6 + ...)
    tail = builder.fmul(builder.fmul(r, r), _polynomial(builder, lanes, r, powers[::-1]))
    return _power_of_two(builder, lanes, k), builder.fadd(r, tail)


def _exp(builder, lanes, x):
    scale, q = _exponent_parts(builder, lanes, x)
    return builder.fadd(scale, builder.fmul(scale, q))


def _expm1(builder, lanes, x):
    scale, q = _exponent_parts(builder, lanes, x)
    return builder.fadd(builder.fsub(scale, lanes.constant(1.0)), builder.fmul(scale, q))


def _log1p(builder, lanes, x):
    """log(1 + x) for 1 + x positive and normal; the rounding of 1 + x is put back."""
    one = lanes.constant(1.0)
    u = builder.fadd(one, x)
    lost = builder.fdiv(builder.fsub(x, builder.fsub(u, one)), u)
    single = lanes.real.bitwidth == 32
    width, half = (23, 0x3F3504F3) if single else (52, 0x3FE6A09E667F3BCD)
    bits = builder.sub(builder.bitcast(u, lanes.whole), lanes.integer(half))
    k = builder.sitofp(builder.ashr(bits, lanes.integer(width)), lanes.vector)
    mantissa = builder.and_(bits, lanes.integer((1 << width) - 1))
    m = builder.bitcast(builder.add(mantissa, lanes.integer(half)), lanes.vector)
    f = builder.fsub(m, one)
    s = builder.fdiv(f, builder.fadd(lanes.constant(2.0), f))
    z = builder.fmul(s, s)
    # log(m) = 2 s (1 + z/3 + z^2/5 + ...), |s| < .172
    series = [2.0 / (2 * n + 1) for n in range(5 if single else 11)]
    log_m = builder.fmul(s, _polynomial(builder, lanes, z, series[::-1]))
    log_k = builder.fmul(k, lanes.constant(0.6931471805599453))
    return builder.fadd(builder.fadd(log_m, lost), log_k)


_unary(np.exp, _exp)
_unary(np.expm1, _expm1)
_unary(np.log1p, _log1p)
