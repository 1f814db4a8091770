"""What laws and layers do with the numbers of 16 particles, for one: minimum and maximum, roots,
and exp and its kin by the formulas of lanes/functions.py, operation by operation, so that the bits
are the same.
"""

import math

import numpy as np
from numba import cuda

from ...device.select import select
from ...lanes import functions, rows
from .words import SIMULATED, Written

# constants of a program, by its precision: see `constants`
REAL = WHOLE = None
BITS = MASK = WIDTH = BIAS = HALF = MANTISSA = 0
UNIT = SHIFT = UP = LEAST = LN2 = HIGH = LOW = LOG2_E = ROUND = MOST = 0.0


def constants(real: np.dtype) -> dict:
    """What the functions of this file call numbers of their precision."""
    single = np.dtype(real) == np.float32
    bits, width = (29, 23) if single else (52, 52)
    high, low = functions._LN2[32 if single else 64]
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
    """{name: Written} of the polynomials of lanes/functions.py in this precision."""
    single, powers, factorial = np.dtype(real) == np.float32, [], 1.0
    for n in range(2, 9 if single else 15):
        factorial *= n
        powers.append(1.0 / factorial)
    series = [2.0 / (2 * n + 1) for n in range(5 if single else 11)]
    of = {"tail": powers[::-1], "series_0": series[::-1], "series_1": series[:0:-1]}
    return {name: Written(name, _horner(name, terms)) for name, terms in of.items()}


def _horner(name: str, terms: list[float]) -> str:
    """The text of a polynomial, its terms from the highest power down."""
    text = f"REAL({terms[0]!r})"
    for one in terms[1:]:
        text = f"({text} * x + REAL({one!r}))"
    return f"def {name}(x):\n    return {text}"


def bits(x):
    return x.view(WHOLE)


def number(whole):
    return WHOLE(whole).view(REAL)


def highest(a, b):
    """The larger; not a number where a is none."""
    return a if (a > b or a != a) else b


def lowest(a, b):
    return a if (a < b or a != a) else b


def higher(a, b):
    """a where it is larger, else b."""
    return a if a > b else b


def either(mask, a, b):
    return a if mask else b


def both(a, b):
    return a and b


def one_of(a, b):
    return a or b


def opposite(a):
    return not a


def _parts(x):
    """exp(x) = 2^k (1 + q): (2^k, q)."""
    x = MOST if x >= MOST else x
    x = -MOST if x <= -MOST else x
    raised = x * LOG2_E + ROUND  # rounds to a whole number, ties to even
    k = raised - ROUND
    r = x - k * HIGH
    r = r - k * LOW
    scale = number((bits(k + ROUND) + BIAS) << WIDTH)
    return scale, r + (r * r) * tail(r)  # noqa: F821  (a polynomial)


def exp(x):
    scale, q = _parts(x)
    return scale + scale * q


def expm1(x):
    scale, q = _parts(x)
    return (scale - 1.0) + scale * q


def _split(u):
    """u = 2^k (1 + f): (k, f, s = f / (2 + f), s^2)."""
    b = WHOLE(bits(u) - WHOLE(HALF))
    k = REAL(b >> WIDTH)
    f = number((b & MANTISSA) + WHOLE(HALF)) - 1.0
    s = f / (2.0 + f)
    return k, f, s, s * s


def _ends(u, value):
    value = value if u < np.inf else u
    end = np.nan if u < 0.0 else -np.inf
    return end if u <= 0.0 else value


def log1p(x):
    u = 1.0 + x
    lost = (x - (u - 1.0)) / u
    k, f, s, z = _split(u)
    return _ends(u, (s * series_0(z) + lost) + k * LN2)  # noqa: F821


def log(x):
    small = x < LEAST
    k, f, s, z = _split(x * UP if small else x)
    k = k - SHIFT if small else k
    half = (0.5 * f) * f
    rest = s * (half + z * series_1(z)) + k * LOW  # noqa: F821
    return _ends(x, k * HIGH + (f - (half - rest)))


# numpy's roots keep the precision of what they are of; a card has them in math
root = np.sqrt if SIMULATED else math.sqrt
rint = np.rint if SIMULATED else cuda.libdevice.rint


def signed(x, y):
    return REAL(math.copysign(x, y))


def fraction(row, at):
    """Where in its cell a position lies, 0 .. 1."""
    return REAL(row[at] & MASK) * UNIT


def cell_offset(row, at, stride):
    """(cell + 3) stride of a position, as a number."""
    return REAL((row[at] >> BITS) + 3) * REAL(stride)


def move(row, at, distance):
    """Add a distance [2^-bits cells], rounded down, to a position; returns it in cells."""
    row[at] = WHOLE(row[at] + WHOLE(math.floor(distance)))
    return REAL(row[at]) * UNIT


PLAIN = {
    np.exp: exp, np.expm1: expm1, np.log: log, np.log1p: log1p, np.sqrt: root, np.abs: abs,
    np.copysign: signed, np.floor: math.floor, np.maximum: highest, np.minimum: lowest,
    np.rint: rint, np.logical_and: both, np.logical_or: one_of, np.logical_not: opposite,
    select: either, rows.higher: higher, rows.fraction: fraction, rows.cell_offset: cell_offset,
    rows.move: move,
}  # fmt: skip
