"""Scalar math on the GPU with the bits of the CPU's vectors.

Minimum, maximum, roots, and exp and related functions follow the formulas of
kernels/simd/math_functions.py operation by operation, so that the bits are equal.
"""

import math

import numpy as np
from numba import cuda

from vgmpi.kernels.simd import math_functions, row_ops
from vgmpi.materials.tensor_math.select import select

from .translation_types import SIMULATED, SourceFunction

# Constants of a translator, by its precision; see `constants`.
REAL = WHOLE = None
BITS = MASK = WIDTH = BIAS = HALF = MANTISSA = 0
UNIT = SHIFT = UP = LEAST = LN2 = HIGH = LOW = LOG2_E = ROUND = MOST = 0.0


def constants(real: np.dtype) -> dict:
    """Return the constants of this file in a precision, by name."""
    single = np.dtype(real) == np.float32
    bits, width = (29, 23) if single else (52, 52)
    high, low = math_functions._LN2[32 if single else 64]
    return {
        "WHOLE": np.int32 if single else np.int64,
        "BITS": bits, "MASK": (1 << bits) - 1, "UNIT": 2.0**-bits,
        "WIDTH": width, "BIAS": 127 if single else 1023,
        "HALF": 0x3F3504F3 if single else 0x3FE6A09E667F3BCD, "MANTISSA": (1 << width) - 1,
        "SHIFT": 24.0 if single else 54.0, "UP": 2.0**24 if single else 2.0**54,
        "LEAST": 2.0**-126 if single else 2.0**-1022,
        "LN2": 0.6931471805599453, "HIGH": high, "LOW": low, "LOG2_E": 1.4426950408889634,
        "ROUND": 1.5 * 2.0**width, "MOST": 87.0 if single else 708.0,
    }  # fmt: skip


def polynomials(real: np.dtype) -> dict:
    """Return the polynomials of the SIMD math functions in a precision, by name."""
    single, powers, factorial = np.dtype(real) == np.float32, [], 1.0
    for n in range(2, 9 if single else 15):
        factorial *= n
        powers.append(1.0 / factorial)
    series = [2.0 / (2 * n + 1) for n in range(5 if single else 11)]
    coefficients = {"tail": powers[::-1], "series_0": series[::-1], "series_1": series[:0:-1]}
    return {
        name: SourceFunction(name, _horner(name, terms)) for name, terms in coefficients.items()
    }


def _horner(name: str, terms: list[float]) -> str:
    """Return the source of a polynomial; terms: coefficients from the highest power down."""
    text = f"REAL({terms[0]!r})"
    for term in terms[1:]:
        text = f"({text} * x + REAL({term!r}))"
    return f"def {name}(x):\n    return {text}"


def bits(x):
    """Return the bits of a number as an integer."""
    return x.view(WHOLE)


def number(integer):
    """Return the number with the bits of an integer."""
    return WHOLE(integer).view(REAL)


def highest(a, b):
    """Return the larger number, NaN if a is NaN."""
    return a if (a > b or a != a) else b


def lowest(a, b):
    """Return the smaller number, NaN if a is NaN."""
    return a if (a < b or a != a) else b


def higher(a, b):
    """Return a where it is larger, else b."""
    return a if a > b else b


def either(mask, a, b):
    """Return a where the mask is true, else b."""
    return a if mask else b


def both(a, b):
    """Return the logical and."""
    return a and b


def one_of(a, b):
    """Return the logical or."""
    return a or b


def opposite(a):
    """Return the logical not."""
    return not a


def _parts(x):
    """Return 2^k and q of exp(x) = 2^k (1 + q)."""
    x = MOST if x >= MOST else x
    x = -MOST if x <= -MOST else x
    raised = x * LOG2_E + ROUND  # rounds to an integer, ties to even
    k = raised - ROUND
    r = x - k * HIGH
    r = r - k * LOW
    scale = number((bits(k + ROUND) + BIAS) << WIDTH)
    return scale, r + (r * r) * tail(r)  # noqa: F821  (a polynomial)


def exp(x):
    """Return e^x."""
    scale, q = _parts(x)
    return scale + scale * q


def expm1(x):
    """Return e^x - 1, accurate near 0."""
    scale, q = _parts(x)
    return (scale - 1.0) + scale * q


def _split(u):
    """Return k, f, s = f / (2 + f) and s^2 of u = 2^k (1 + f)."""
    b = WHOLE(bits(u) - WHOLE(HALF))
    k = REAL(b >> WIDTH)
    f = number((b & MANTISSA) + WHOLE(HALF)) - 1.0
    s = f / (2.0 + f)
    return k, f, s, s * s


def _ends(u, value):
    """Return the logarithm of u, with the values at 0, infinity and negative numbers."""
    value = value if u < np.inf else u
    end = np.nan if u < 0.0 else -np.inf
    return end if u <= 0.0 else value


def log1p(x):
    """Return log(1 + x), accurate near 0."""
    u = 1.0 + x
    lost = (x - (u - 1.0)) / u
    k, f, s, z = _split(u)
    return _ends(u, (s * series_0(z) + lost) + k * LN2)  # noqa: F821


def log(x):
    """Return the natural logarithm of x."""
    small = x < LEAST
    k, f, s, z = _split(x * UP if small else x)
    k = k - SHIFT if small else k
    half = (0.5 * f) * f
    correction = s * (half + z * series_1(z)) + k * LOW  # noqa: F821
    return _ends(x, k * HIGH + (f - (half - correction)))


# NumPy's roots keep the precision of their argument; on the GPU they are in math.
root = np.sqrt if SIMULATED else math.sqrt
rint = np.rint if SIMULATED else cuda.libdevice.rint


def signed(x, y):
    """Return x with the sign of y."""
    return REAL(math.copysign(x, y))


def fraction(row, index):
    """Return the position inside its cell, 0 to 1."""
    return REAL(row[index] & MASK) * UNIT


def cell_offset(row, index, stride):
    """Return (cell + 3) stride of a position, as a number."""
    return REAL((row[index] >> BITS) + 3) * REAL(stride)


def move(row, index, distance):
    """Add a distance [2^-bits cells], rounded down, to a position; return it [cells]."""
    row[index] = WHOLE(row[index] + WHOLE(math.floor(distance)))
    return REAL(row[index]) * UNIT


PLAIN = {
    np.exp: exp, np.expm1: expm1, np.log: log, np.log1p: log1p, np.sqrt: root, np.abs: abs,
    np.copysign: signed, np.floor: math.floor, np.maximum: highest, np.minimum: lowest,
    np.rint: rint, np.logical_and: both, np.logical_or: one_of, np.logical_not: opposite,
    select: either, row_ops.max_ignore_nan: higher, row_ops.cell_fraction: fraction,
    row_ops.stencil_offset: cell_offset,
    row_ops.add_fixed_point: move,
}  # fmt: skip
