"""The card's engine in numba's simulator gives the processor's bits: every law, walls, contact,
couplings, transfers, colors, colliders that move, inlets; and what is broken there is found.

The processor does not contract products and sums here (VGMPI_CONTRACTION=off), as a card does not.
Each test is a program of its own (tests/support/cuda_bits.py).
"""

import sys

import pytest

from tests.solver.test_engines import SCENES
from tests.support.launch import finish, start

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
pytest.importorskip("greenlet", reason="the simulator's threads take turns by greenlet")

SHORT = {  # name: precision, steps, scenes
    "flow": ("single", 4, ["fluid", "paste", "foam"]),
    "grains": ("single", 4, ["sand", "snow", "metal"]),
    "solids": ("single", 4, ["elastic", "corotated", "plasticine"]),
    "contact": ("single", 3, ["contact", "three in contact", "contact of faces"]),
    "walls": ("single", 2, ["walls that vanish", "open walls", "colliders that move"]),
    "pushed": ("single", 2, ["pushed along walls", "pushed by a driven body"]),
    "transfers": ("single", 7, ["flip by steps", "apic", "pic with bspline", "apic-corrected"]),
    "couplings": ("single", 2, ["mixing", "drag"]),
    "more": (
        "single",
        3,
        [
            "inlets and outlets",
            "deformation",
            "driven tin",
            "density correction",
            "several densities",
            "dilatation by cells",
            "regions",
        ],
    ),
    "double": ("double", 2, ["fluid", "sand", "elastic", "contact"]),
}


def told(*arguments) -> list[str]:
    job = finish(start([sys.executable, "-m", "tests.support.cuda_bits", *map(str, arguments)]))
    assert job.returncode == 0, job.stderr[-2000:]
    return job.stdout.splitlines()


def check(precision, steps, scenes):
    lines = told(precision, steps, *scenes)
    print("\n".join(lines))
    assert [line for line in lines if not line.startswith("same ")] == []
    assert len(lines) == len(scenes)
    if precision == "double":  # and as near to plain numpy as the processor's engine
        assert all(float(line.split()[-3]) < 1e-12 for line in lines)


@pytest.mark.parametrize("name", SHORT)
def test_the_card_has_the_processors_bits(name):
    check(*SHORT[name])


@pytest.mark.slow
@pytest.mark.parametrize("precision, steps", [("single", 10), ("double", 3)])
@pytest.mark.parametrize("name", SCENES)
def test_the_card_has_the_processors_bits_in_every_scene(name, precision, steps):
    check(precision, steps, [name])


@pytest.mark.parametrize("order", [1, 2])
def test_the_order_of_threads_and_segments_does_not_matter(order):
    (line,) = told("single", 2, "contact", "--order", order, "--break", "reversed")
    assert line.startswith("same "), line


def test_two_half_warps_of_a_block_do_not_meet():
    """As on a card: each waits for itself alone."""
    lines = told("single", 2, "contact", "sand", "--halves", "--order", 3)
    assert [line[:5] for line in lines] == ["same ", "same "], lines


@pytest.mark.parametrize(
    "what", ["ownership", "meeting", "meeting at nodes", "order", "list", "lane"]
)
def test_what_is_broken_is_found(what):
    job = finish(
        start([sys.executable, "-m", "tests.support.cuda_bits", "single", "2", "contact", "--order",
        "1",
               "--break", what])
    )  # fmt: skip
    assert "same" not in job.stdout
    assert "OTHER contact" in job.stdout or "BlowUp" in job.stderr, job.stderr[-2000:]
