"""What the machine can do at most, and what a particle needs at least: the floor under a step.

Bytes of a particle and step, counted from its channels; a word is 4 bytes in single precision, 8 in
double. Particles to grid reads position 3, velocity 3, affine matrix 9, volume 1 and the state s;
grid to particles reads position 3 and the state, and writes position 3, velocity 3, affine matrix 9
and the state: 34 + 3 s words. Not counted: nodes, patches, ids, sorting, and that a processor reads
a line before it writes to it. Particles that fit in the last cache need not come from memory at
all, so a fraction above 1 is possible there.

Flops: every formula of the law (advance, stress, volume_ratio, wave_speed2) run once on numbers
that count; and of a transfer what its factored form cannot avoid: weights 3 axes x 8 in each
direction; to the grid 27 nodes x 4 numbers x 3 (one sum along an axis, one product with the weight,
one sum into the node) and 50 for momentum, mass and slopes; back 27 nodes x 3 velocities x 2 and as
much again for three moments; 30 for the motion.
"""

import functools
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.materials.material import law_function, state_channels
from vgmpi.planning.plan import FLOAT_TYPES
from vgmpi.runtime.jit import kernel

LENGTH = 1 << 25  # numbers of an array of 128 MiB: far larger than a cache
CHAINS = 12  # independent sums, enough to hide the time a fused multiply-add takes
TRANSFER_FLOPS = 2 * 3 * 8 + 27 * 4 * 3 + 50 + 2 * 27 * 3 * 2 + 30
FUNCTION_FLOPS = {"exp": 20, "expm1": 20, "log": 20, "log1p": 20}  # short polynomials


@kernel
def copy(a, b, first, last):
    """Copy numbers first to last of b to a."""
    for i in range(first, last, 16):
        store(a, i, load(b, i))


@kernel
def triad(a, b, c, first, last):
    """Compute a = b + 3 c for numbers first to last."""
    for i in range(first, last, 16):
        store(a, i, load(b, i) + b.dtype.type(3) * load(c, i))


@kernel
def multiply_add(row, first, last):
    """12 chains of fused multiply-adds on 16 lanes; row: (48,), the last third is the result."""
    b, c = load(row, 0), load(row, 16)
    r0, r1, r2, r3 = b, c, b, c
    r4, r5, r6, r7 = b, c, b, c
    r8, r9, ra, rb = b, c, b, c
    for _ in range(first, last):
        r0, r1, r2, r3 = r0 * b + c, r1 * b + c, r2 * b + c, r3 * b + c
        r4, r5, r6, r7 = r4 * b + c, r5 * b + c, r6 * b + c, r7 * b + c
        r8, r9, ra, rb = r8 * b + c, r9 * b + c, ra * b + c, rb * b + c
    store(row, 32, r0 + r1 + r2 + r3 + r4 + r5 + r6 + r7 + r8 + r9 + ra + rb)


def measure_roofline(length: int = LENGTH, repeats: int = 5) -> dict:
    """Measure copy and triad [GB/s] by threads and fused multiply-adds [GFlop/s] by precision.

    Copy counts 8 bytes per number, triad 12; the multiply-adds are those of one core.
    """
    a, b, c = (np.ones(length, np.float32) for _ in range(3))
    copies, triads = {}, {}
    for threads in (1, 2)[: len(os.sched_getaffinity(0))]:
        copies[str(threads)] = 8e-9 * length / _least(threads, length, repeats, copy, a, b)
        triads[str(threads)] = 12e-9 * length / _least(threads, length, repeats, triad, a, b, c)
    peak = {}
    for precision, real in FLOAT_TYPES.items():
        row, turns = np.full(48, 0.5, real), length // 4
        best = _least(1, turns, repeats, multiply_add, row)
        peak[precision] = 2e-9 * CHAINS * 16 * turns / best
    return {"copy": copies, "triad": triads, "fma": peak}


def _least(threads: int, length: int, repeats: int, action, *arrays) -> float:
    """Return the seconds of the quickest of `repeats` calls, after one that compiles.

    `threads` threads share the length.
    """
    cut = np.linspace(0, length // 16, threads + 1).astype(int) * 16
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats + 1):
            began = time.perf_counter()
            parts = [
                pool.submit(functools.partial(action, *arrays, cut[k], cut[k + 1]))
                for k in range(threads)
            ]
            for part in parts:
                part.result()
            seconds.append(time.perf_counter() - began)
    return min(seconds[1:])


def operation_count(material) -> dict:
    """Words and flops of one particle and step of a material."""
    law = material.law()
    return {
        "words": 34 + 3 * state_channels(type(law)),
        "flops": TRANSFER_FLOPS + law_flops(material),
    }


def minimum_time(roof: dict, need: dict, precision: str, cores: int = 1) -> float:
    """Return the minimum time [ns] per particle and step: memory or arithmetic, the slower one.

    Args:
        roof: Result of measure_roofline.
        need: Result of operation_count.
        precision: "single" or "double".
        cores: Number of cores.
    """
    measured = str(cores) if str(cores) in roof["copy"] else "1"
    bandwidth = max(roof[kind][c] for kind in ("copy", "triad") for c in ("1", measured))
    width = FLOAT_TYPES[precision].itemsize
    return max(need["words"] * width / bandwidth, need["flops"] / roof["fma"][precision] / cores)


class _Counted:
    """A number of which only the operations are counted."""

    __array_priority__ = 1000

    def __init__(self, tally: list):
        self.tally = tally

    def _done(self, *_):
        self.tally[0] += 1
        return _Counted(self.tally)

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _done
    __truediv__ = __rtruediv__ = __abs__ = _done
    __lt__ = __le__ = __gt__ = __ge__ = __and__ = __or__ = _done

    def __neg__(self):
        return self  # goes into the next product

    def __array_ufunc__(self, ufunc, method, *inputs, **named):
        self.tally[0] += FUNCTION_FLOPS.get(ufunc.__name__, 1)
        return _Counted(self.tally)

    def __array_function__(self, function, kinds, arguments, named):
        return self._done()  # np.where of materials/tensor_math/select.py

    def __getitem__(self, nothing):
        return self


def law_flops(material) -> int:
    """Flops of the law of one particle and step; 0 where it uses what cannot be counted."""
    law, tally = material.law(), [0]

    def numbers(n):
        """Return n counted numbers."""
        return tuple(_Counted(tally) for _ in range(n))

    state, L = numbers(state_channels(type(law))), numbers(9)
    try:
        law_function(law, "stress")(law, state, L)
        state = law_function(law, "advance")(law, state, L, _Counted(tally))
        law_function(law, "volume_ratio")(law, state)
        law_function(law, "wave_speed2")(law, state)
    except (TypeError, AttributeError, NotImplementedError):
        return 0
    return tally[0]
