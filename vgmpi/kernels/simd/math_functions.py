"""Vector functions exp, expm1, log, log1p and cbrt for 16 particles, as polynomials.

Importing this module defines them. NaN stays NaN. Largest error over the whole range, in units of
the last place:

    exp     1    beyond +-87 (single) or +-708 (double) x is clamped: no infinity and no 0 result
    expm1   2    clamped in the same way
    log     1    includes denormal numbers; -inf at 0, NaN below
    log1p   3    -inf at -1, NaN below
    cbrt    1    includes denormal numbers
"""

import numpy as np

from .vector16 import call, unary

# ln 2 in two parts, so that an integer times the first is exact
_LN2 = {
    32: (0.693359375, -2.12194440e-4),
    64: (0.6931471803691238, 1.9082149292705877e-10),
}


def _polynomial(builder, lanes, x, coefficients):
    """Emit Horner's scheme; coefficients from the highest power down."""
    total = lanes.constant(coefficients[0])
    for c in coefficients[1:]:
        total = builder.fadd(builder.fmul(total, x), lanes.constant(c))
    return total


def _limit(builder, x, sign, bound):
    """Emit `bound` where x < bound (or >, by the sign) does not hold; NaN stays NaN."""
    return builder.select(builder.fcmp_unordered(sign, x, bound), x, bound)


# ---- exponentials -------------------------------------------------------------------------------


def _power_of_two(builder, lanes, k):
    """Emit 2^k for a vector of integers k, stored as reals."""
    bias, width = (127, 23) if lanes.real.bitwidth == 32 else (1023, 52)
    # Added to 1.5 2^width, an integer has its value in the lowest bits; the conversion of NaN to an
    # integer would be undefined.
    integer = builder.bitcast(
        builder.fadd(k, lanes.constant(1.5 * 2.0**width)), lanes.integer_vector
    )
    integer = builder.add(integer, lanes.integer(bias))
    return builder.bitcast(builder.shl(integer, lanes.integer(width)), lanes.vector)


def _exponent_parts(builder, lanes, x):
    """Emit 2^k and q of exp(x) = 2^k (1 + q), q accurate near 0; x is clamped to the range."""
    single = lanes.real.bitwidth == 32
    limit = 87.0 if single else 708.0
    x = _limit(builder, x, "<", lanes.constant(limit))
    x = _limit(builder, x, ">", lanes.constant(-limit))
    high, low = _LN2[lanes.real.bitwidth]
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
    """Emit e^x."""
    scale, q = _exponent_parts(builder, lanes, x)
    return builder.fadd(scale, builder.fmul(scale, q))


def _expm1(builder, lanes, x):
    """Emit e^x - 1."""
    scale, q = _exponent_parts(builder, lanes, x)
    return builder.fadd(builder.fsub(scale, lanes.constant(1.0)), builder.fmul(scale, q))


# ---- logarithms ---------------------------------------------------------------------------------


def _split(builder, lanes, u):
    """Emit k, f, s and z of u = 2^k (1 + f), for u positive and normal, 0.7 < 1 + f < 1.42.

    s = f / (2 + f), |s| < 0.172, and z = s^2; log(1 + f) = 2 s (1 + z/3 + z^2/5 + ...).
    """
    single = lanes.real.bitwidth == 32
    width, half = (23, 0x3F3504F3) if single else (52, 0x3FE6A09E667F3BCD)
    bits = builder.sub(builder.bitcast(u, lanes.integer_vector), lanes.integer(half))
    k = builder.sitofp(builder.ashr(bits, lanes.integer(width)), lanes.vector)
    mantissa = builder.and_(bits, lanes.integer((1 << width) - 1))
    m = builder.bitcast(builder.add(mantissa, lanes.integer(half)), lanes.vector)
    f = builder.fsub(m, lanes.constant(1.0))
    s = builder.fdiv(f, builder.fadd(lanes.constant(2.0), f))
    return k, f, s, builder.fmul(s, s)


def _series(lanes, first):
    """Return 2 / (2 n + 1) from n = `first` on, the highest power first."""
    return [2.0 / (2 * n + 1) for n in range(first, 5 if lanes.real.bitwidth == 32 else 11)][::-1]


def _with_limits(builder, lanes, u, value):
    """Emit the logarithm of u: `value` where u is positive and finite."""
    zero, infinity = lanes.constant(0.0), lanes.constant(np.inf)
    value = builder.select(builder.fcmp_ordered("<", u, infinity), value, u)
    none = lanes.constant(np.nan)
    end = builder.select(builder.fcmp_ordered("<", u, zero), none, lanes.constant(-np.inf))
    return builder.select(builder.fcmp_ordered("<=", u, zero), end, value)


def _log1p(builder, lanes, x):
    """Emit log(1 + x); the rounding error of 1 + x is added back."""
    unit = lanes.constant(1.0)
    u = builder.fadd(unit, x)
    lost = builder.fdiv(builder.fsub(x, builder.fsub(u, unit)), u)
    k, _, s, z = _split(builder, lanes, u)
    log_m = builder.fmul(s, _polynomial(builder, lanes, z, _series(lanes, 0)))
    log_k = builder.fmul(k, lanes.constant(0.6931471805599453))
    value = builder.fadd(builder.fadd(log_m, lost), log_k)
    return _with_limits(builder, lanes, u, value)


def _normal(builder, lanes, x, shift):
    """Emit x 2^shift and a mask where x is below the normal numbers, x elsewhere."""
    min_normal = lanes.constant(2.0**-126 if lanes.real.bitwidth == 32 else 2.0**-1022)
    small = builder.fcmp_ordered("<", x, min_normal)
    raised = builder.fmul(x, lanes.constant(2.0**shift))
    return builder.select(small, raised, x), small


def _log(builder, lanes, x):
    """Emit log(x)."""
    shift = 24 if lanes.real.bitwidth == 32 else 54
    u, small = _normal(builder, lanes, x, shift)
    k, f, s, z = _split(builder, lanes, u)
    k = builder.select(small, builder.fsub(k, lanes.constant(float(shift))), k)
    # 2 s = f - f^2/2 + s f^2/2: the largest term is then exact (as in fdlibm)
    half = builder.fmul(builder.fmul(lanes.constant(0.5), f), f)
    correction = builder.fmul(z, _polynomial(builder, lanes, z, _series(lanes, 1)))
    correction = builder.fmul(s, builder.fadd(half, correction))
    high, low = _LN2[lanes.real.bitwidth]
    correction = builder.fadd(correction, builder.fmul(k, lanes.constant(low)))
    value = builder.fsub(f, builder.fsub(half, correction))
    value = builder.fadd(builder.fmul(k, lanes.constant(high)), value)
    return _with_limits(builder, lanes, x, value)


# ---- cube root ----------------------------------------------------------------------------------


def _cbrt(builder, lanes, x):
    """Emit the cube root of x, by Halley's iteration."""
    single = lanes.real.bitwidth == 32
    shift = 24 if single else 54
    u, small = _normal(builder, lanes, call("llvm.fabs")(builder, lanes, x), shift)
    # A third of the exponent: dividing the bits by 3 is accurate to 4 %.
    bits = builder.sitofp(builder.bitcast(u, lanes.integer_vector), lanes.vector)
    first = 709921077.0 if single else 715094163.0 * 2.0**32
    third = builder.fadd(builder.fmul(bits, lanes.constant(1 / 3)), lanes.constant(first))
    t = builder.bitcast(builder.fptosi(third, lanes.integer_vector), lanes.vector)
    for _ in range(2 if single else 3):
        # Halley's iteration cubes the error.
        r = builder.fdiv(u, builder.fmul(t, t))
        part = builder.fdiv(builder.fsub(r, t), builder.fadd(builder.fadd(t, t), r))
        t = builder.fadd(t, builder.fmul(t, part))
    t = builder.select(small, builder.fmul(t, lanes.constant(2.0 ** (-shift // 3))), t)
    t = call("llvm.copysign")(builder, lanes, t, x)
    # 0, infinity and NaN are their own roots.
    finite = builder.and_(
        builder.fcmp_ordered(">", u, lanes.constant(0.0)),
        builder.fcmp_ordered("<", u, lanes.constant(np.inf)),
    )
    return builder.select(finite, t, x)


unary(np.exp, _exp)
unary(np.expm1, _expm1)
unary(np.log, _log)
unary(np.log1p, _log1p)
unary(np.cbrt, _cbrt)
