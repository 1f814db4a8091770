"""A run on cards, simulated: on one and two ranks, and from one engine's checkpoint on with the
other, it writes the files of the processor's run, byte by byte.
"""

import pytest

from tests.support.file_digests import digests
from tests.support.launch import mpirun
from tests.support.small_scenes import write

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
pytest.importorskip("greenlet", reason="the simulator's threads take turns by greenlet")
pytestmark = pytest.mark.mpi
SCENE = """
[domain]
size = [0.4, 0.16, 0.16]
cell = 0.04
[time]
end = 0.024
frames = 3
[accuracy]
pressure = "explicit"
precision = "single"
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[material.rubber]
kind = "elastic"
density = 500
youngs_modulus = 5e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.16, 0.16, 0.06]] }
velocity = [3, 0, 0]
[[object]]
name = "toy"
material = "rubber"
shape = { box = [[0.2, 0.04, 0.04], [0.28, 0.12, 0.12]] }
velocity = [-4, 0, 0]
[output]
checkpoint_interval_steps = 6
"""
PLAIN = {"VGMPI_CONTRACTION": "off"}


def run(scene, out, n, engine, *flags):
    job = mpirun(
        n, "-m", "tests.parallel.card_job", scene, "-q", "-o", out, "--engine", engine, *flags,
        env=PLAIN,
    )  # fmt: skip
    assert job.returncode in (0, 75), job.stderr[-2000:]
    found = digests(out)
    # how long it took, and on how many ranks, is no part of the result
    return {k: v for k, v in found.items() if ".h5:" in k or ".vtkhdf:" in k or "ledger" in k}


def test_cards_have_the_processors_files(tmp_path):
    scene = write(tmp_path, SCENE)
    want = run(scene, tmp_path / "cpu", 1, "cpu")
    assert any("frames" in name for name in want)
    assert run(scene, tmp_path / "two", 2, "cuda") == want
    # half of it on the processor, on one rank; the rest on a card
    run(scene, tmp_path / "half", 1, "cpu", "--stop-after", "7 steps")
    assert run(scene, tmp_path / "half", 1, "cuda", "--resume") == want
