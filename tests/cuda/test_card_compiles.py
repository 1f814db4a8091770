"""Every kernel of every law compiles for an A100 (sm_80) and an H100 (sm_90) without a card: none
spills, in single precision nothing but sums at nodes, contact and walls is computed in double, and
no product is contracted with a sum.
"""

import pytest

from vgmpi.materials import registry

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
registers = pytest.importorskip("tests.benchmarks.gpu_registers")

# these are in double precision on every engine: a body's motion, contact and walls, sums at rest
DOUBLE = {"update", "update_apart", "settle", "blend", "reset", "advect_prescribed"}
# of `fill`: what rounds a term to a sum's quantum and adds it, once in the text
SUMS = r"(cvt\.f64\.f32|mul\.rn\.f64|add\.rn\.f64|sub\.rn\.f64|setp\.\w+\.f64|neg\.f64)"


@pytest.fixture(scope="module", autouse=True)
def assembler():
    from vgmpi.solver.engines.cuda.offline_compile import assembler, resource_usage

    try:
        resource_usage(
            ".version 7.0\n.target sm_80\n.address_size 64\n.visible .entry e() { ret; }", 80
        )
    except (OSError, RuntimeError) as error:
        pytest.skip(f"no ptxas ({assembler()}): {error}")


def check(case, only=()):
    found = registers.compiled(case, only=only)
    assert {one.card for one in found} == {80, 90}
    for one in found:
        assert one.spilled == 0, one[:-1]
        assert not one.link_time, one[:-1]  # the linker contracts what the compiler did not
        assert one.count(r"fma\.rn\.f") == 0, one[:-1]
        assert one.count(r"\bcall\b") == 0, one[:-1]
        doubles = one.count(r"^\s+(@\S+ )?[a-z0-9_.]*\.f64\b")
        if one.name.startswith("fill "):
            assert 0 < one.count(SUMS) <= 12, one[:-1]
        elif one.name not in DOUBLE:
            assert doubles == 0, one[:-1]
    return found


@pytest.mark.parametrize("law", registry)
def test_every_law_compiles_without_spills_doubles_or_contraction(law):
    found = check(law, only=("fill", "g2p"))
    assert {(one.name, one.law) for one in found} == {("fill momentum", law), ("g2p", law)}


QUICK = "fluid", "driven", "several densities", "dilatation by cells"


# the others are compiled by `make validate`: minutes
@pytest.mark.parametrize(
    "case",
    [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
        for name in ("fluid", *(name for name in registers.CASES if name not in registry))
    ],
)
def test_what_else_a_scene_asks_for_compiles(case):
    names = {one.name for one in check(case)}
    moves = {
        "driven": {"fill momentumwithoutstress", "advect_prescribed"},
        "several densities": {"fill restvolume", "settle", "g2p"},
        "dilatation by cells": {"fill cellpressure", "fill momentumwithoutpressure", "g2p"},
    }
    assert moves.get(case, {"g2p"}) | {"tag", "order"} <= names


def test_what_contracts_is_seen():
    """numba contracts as it comes: the test above would find it."""
    from numba.cuda.cudadrv import nvvm

    found = registers.compiled("elastic", cards=(90,), only=("g2p",))
    assert sum(one.count(r"fma\.rn\.f") for one in found) == 0
    plain, nvvm.compile_ir = nvvm.compile_ir, nvvm.compile_ir.usual
    try:
        found = registers.compiled("elastic", cards=(90,), only=("g2p",))
    finally:
        nvvm.compile_ir = plain
    assert sum(one.count(r"fma\.rn\.f") for one in found) > 100
