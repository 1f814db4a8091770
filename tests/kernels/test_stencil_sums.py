"""Sums over rows and transposes have the same bits however many nodes they take at a time."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from tests.support import register_spills
from vgmpi.kernels import cell_stencil_sums, stencil_sums  # noqa: F401  (their functions)
from vgmpi.kernels.particle_records import PATCH, PLANE, ROW
from vgmpi.kernels.simd import row_ops, vector16
from vgmpi.runtime.cpu_features import widest

REAL = {"single": np.float32, "double": np.float64}
X86 = "x86_64-unknown-linux-gnu"


@functools.cache
def made(name, nodes):
    put, some = stencil_sums.STENCIL_FUNCTIONS[name]
    return put(some, stencil_sums.ROW_SPLITS[nodes])


def bits_of(array):
    return array.view(np.int32 if array.dtype == np.float32 else np.int64)


@pytest.mark.parametrize("precision", REAL)
@pytest.mark.parametrize("name", stencil_sums.STENCIL_FUNCTIONS)
@settings(deadline=None, max_examples=40)
@given(
    count=st.integers(0, 129),
    seed=st.integers(0, 2**32 - 1),
    cells=st.integers(1, 5),
    sorted_=st.booleans(),
)
def test_parts_of_rows_give_the_same_bits(name, precision, count, seed, cells, sorted_):
    """Runs of one base row, runs that overlap in other nodes, and none."""
    random, real = np.random.default_rng(seed), REAL[precision]
    corner = random.integers(0, cells, (count + 1, 3))
    base = (corner @ [PLANE, ROW, 4]).astype(np.int32)
    if sorted_:
        base.sort()
    weights = random.uniform(-1, 1, (count + 1, 16)).astype(real)
    weights[:, 11] = 0  # of the row's fourth node
    records = random.normal(0, 1, (count + 1, 16)).astype(real)
    start = random.normal(0, 1, PATCH + 16).astype(real)
    found = {}
    for nodes in stencil_sums.ROW_SPLITS:
        patch, filled = start.copy(), records.copy().reshape(-1)
        made(name, nodes)(count, filled, weights.reshape(-1), base, patch)
        found[nodes] = np.concatenate([bits_of(patch), bits_of(filled)])
    assert (found[2] == found[4]).all() and (found[1] == found[4]).all()
    if count:
        assert (found[4] != np.concatenate([bits_of(start), bits_of(records.reshape(-1))])).any()


@pytest.mark.parametrize("precision", REAL)
def test_values_alone_add_what_records_without_slopes_add(precision):
    random, real = np.random.default_rng(1), REAL[precision]
    base = np.sort((random.integers(0, 3, (60, 3)) @ [PLANE, ROW, 4]).astype(np.int32))
    weights = random.uniform(0, 1, (60, 16)).astype(real)
    weights[:, 11] = 0
    records = np.zeros((60, 16), real)
    records[:, :4] = random.normal(0, 1, (60, 4))
    patches = np.zeros((2, PATCH + 16), real)

    @njit
    def add_both(records, weights, base, whole, values):
        stencil_sums.scatter(60, records, weights, base, whole)
        stencil_sums.scatter_values(60, records, weights, base, values)

    add_both(records.reshape(-1), weights.reshape(-1), base, *patches)
    assert np.array_equal(*patches)
    assert np.abs(patches).max() > 1


@pytest.mark.parametrize("precision", REAL)
def test_quarters_of_records_are_the_same_records(precision, monkeypatch):
    real = REAL[precision]
    given_ = np.random.default_rng(0).normal(0, 1, 256).astype(real)
    for quarters in (False, True):
        monkeypatch.setattr(row_ops, "QUARTERS", quarters)

        @njit
        def there_and_back(vectors, records, back):
            v = row_ops.load_records(vectors, 0)
            row_ops.store_records(records, 0, v)
            for k in range(16):
                vector16.store(back, 16 * k, v[k])

        records, back = np.zeros(256, real), np.zeros(256, real)
        there_and_back(given_, records, back)
        assert (records == given_).all()
        assert (back.reshape(16, 16) == given_.reshape(16, 16).T).all()


@pytest.mark.parametrize(
    "name, features, register",
    [
        ("haswell", "", 32),
        ("znver3", "", 32),
        ("haswell", "+avx2,+fma,+bmi,+bmi2", 32),
        ("skylake-avx512", "", 64),
        ("znver4", "", 64),
        ("x86-64", "", 16),
    ],
)
def test_registers_of_a_processor(name, features, register):
    assert widest(X86, name, features) == register


def test_parts_spare_the_stack():
    """Whole rows do not fit the registers of AVX2; as they are compiled, the sums nearly do."""
    put, some = stencil_sums.STENCIL_FUNCTIONS["scatter"]
    for precision, real in register_spills.REALS.items():
        nodes = stencil_sums.row_split_for("scatter", 32, real.bitwidth)
        assert nodes == {"single": 2, "double": 1}[precision]
        short = []
        for parts in (stencil_sums.ROW_SPLITS[4], stencil_sums.ROW_SPLITS[nodes]):
            text = register_spills.compiled(put(some, parts), real)
            short.append(
                sum(
                    register_spills.count(
                        register_spills.assembly(text, *register_spills.PROCESSORS["AVX2"])
                    )
                )
            )
        assert short[0] > 40 and short[1] < 10
