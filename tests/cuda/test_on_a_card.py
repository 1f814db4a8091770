"""On a card, the engine has the bits of the processor: every scene of the simulator's test, for
more steps than the simulator has time for. Skipped where there is no card.
"""

import sys

import pytest

from tests.solver.test_engines import SCENES
from tests.support.launch import finish, start

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
card = pytest.importorskip("vgmpi.solver.engines.cuda.graphics_card")
pytestmark = pytest.mark.skipif(card.select_device(0) != "", reason="there is no card")


CASES = [("single", 20, name) for name in SCENES]
CASES += [("double", 6, name) for name in ("fluid", "sand", "elastic", "contact")]


@pytest.mark.parametrize("precision, steps, name", CASES)
def test_a_card_has_the_processors_bits(precision, steps, name):
    command = [sys.executable, "-m", "tests.support.cuda_bits", precision, str(steps), name]
    job = finish(start([*command, "--card"]))
    assert job.returncode == 0, job.stderr[-3000:]
    line = job.stdout.strip()
    print(line)
    assert line.startswith("same "), line
