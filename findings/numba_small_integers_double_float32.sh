#!/usr/bin/env bash
# Packages: numba 0.68.1, numba-cuda 0.30.4, numpy 2.4.6, from PyPI
# Behavior: an integer times a float32 is computed in double precision by compiled code, on processors
#           and in the PTX of a CUDA kernel, also where the integer is a literal of one digit:
#           2 * x is float64 although x + x is float32. NumPy 2 computes both in float32.
# Expected: the rule of NumPy 2, under which a Python integer takes the type of the other operand.
#           Double arithmetic runs at a small fraction of the rate of single on most graphics cards.
# Output seen:
#   numpy: 2 * x is float32
#   numba: 2 * x is float64
#   numba: x + x is float32
#   PTX of 1 - 2 * x * x: 2 operations in double, 0 in single
#   PTX of one - two * x * x in float32: 0 operations in double, 2 in single
# Exits nonzero if this changes. No graphics card is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check numba==0.68.1 "numba-cuda[cu13]==0.30.4" numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import numba
import numpy as np
from numba import cuda, float32, types

x = np.float32(1.5)
plain = (2 * x).dtype


def kind(function):
    """Type that numba infers for the value of a function of one float32."""
    compiled = numba.njit(function)
    compiled(x)
    return str(compiled.nopython_signatures[0].return_type)


doubled, added = kind(lambda a: 2 * a), kind(lambda a: a + a)
print(f"numpy: 2 * x is {plain}")
print(f"numba: 2 * x is {doubled}")
print(f"numba: x + x is {added}")


def with_integers(y, x):
    i = cuda.grid(1)
    y[i] = 1 - 2 * x[i] * x[i]


def with_float32(y, x):
    i = cuda.grid(1)
    y[i] = float32(1) - float32(2) * x[i] * x[i]


counts = []
for name, kernel in (("1 - 2 * x * x", with_integers), ("one - two * x * x in float32", with_float32)):
    ptx, _ = cuda.compile_ptx(kernel, types.void(types.float32[::1], types.float32[::1]), cc=(9, 0))
    words = [line.split()[0] for line in ptx.splitlines() if line.split()]
    arithmetic = [w for w in words if w.startswith(("mul.", "add.", "fma.")) and w.endswith(("f32", "f64"))]
    counts.append([sum(w.endswith(bits) for w in arithmetic) for bits in ("f64", "f32")])
    print(f"PTX of {name}: {counts[-1][0]} operations in double, {counts[-1][1]} in single")
assert (plain, doubled, added) == (np.float32, "float64", "float32"), "the behavior has changed"
assert counts == [[2, 0], [0, 2]], "the behavior has changed"
PYTHON
