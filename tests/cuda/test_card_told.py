"""What a user reads who asks for a card: none is there, threads, too little memory, --plan."""

import numpy as np
import pytest

from tests.support.small_scenes import write
from vgmpi.commands import cli
from vgmpi.parallel.communicator import SerialCommunicator

pytest.importorskip("numba_cuda", reason="the extra `cuda` is not installed")
card = pytest.importorskip("vgmpi.solver.engines.cuda.graphics_card")
SCENE = """
[accuracy]
pressure = "explicit"
precision = "double"
[domain]
size = [0.2, 0.2, 0.2]
cell = 0.04
[time]
end = 0.001
[material.water]
kind = "fluid"
tait_coefficient = 2e4
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.1, 0.16, 0.08]] }
"""


@pytest.fixture
def scene(tmp_path):
    return str(write(tmp_path, SCENE))


def lines(capsys, *flags):
    """(exit code, lines of stderr, stdout) of a command."""
    code = cli.main([*flags])
    said = capsys.readouterr()
    return code, said.err.strip().splitlines(), said.out


@pytest.mark.skipif(card.select_device(0) == "", reason="there is a card")
def test_no_card_is_one_line(scene, capsys, tmp_path):
    code, said, _ = lines(capsys, scene, "--engine", "cuda", "-o", str(tmp_path / "out"))
    assert code == 2 and len(said) == 1
    assert said[0].startswith("--engine cuda finds no card: ") and "driver" in said[0]
    assert not (tmp_path / "out").exists()


def test_a_card_has_no_threads(scene, capsys):
    code, said, _ = lines(capsys, scene, "--engine", "cuda", "--threads", "2")
    assert (code, said) == (2, ["--engine cuda has no threads; asked for 2"])


@pytest.mark.parametrize("free, what", [(None, "no card is here to ask"), (3 << 30, "3 GiB are")])
def test_plan_tells_of_the_card(scene, capsys, monkeypatch, free, what):
    monkeypatch.setattr(card, "free", lambda: free)
    code, _, out = lines(capsys, scene, "--engine", "cuda", "--plan")
    assert code == 0
    (line,) = (line for line in out.splitlines() if "on the card of each rank" in line)
    assert what in line


def test_what_does_not_fit_is_refused(scene, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(card, "select_device", lambda place, rank: "")
    monkeypatch.setattr(card, "free", lambda: 1000)
    code, said, _ = lines(capsys, scene, "--engine", "cuda", "-o", str(tmp_path / "out"))
    assert code == 2
    assert "on the card of each rank, of which one has" in said[-1]


class _Two(SerialCommunicator):
    """Two ranks, of which the other has a card with 10 bytes free."""

    size = 2

    def max(self, values):
        return np.maximum(values, -10.0)


def test_the_fullest_card_counts(scene, monkeypatch):
    from vgmpi.planning.plan import Plan

    monkeypatch.setattr(Plan, "bytes", lambda self: 30)
    monkeypatch.setattr(card, "free", lambda: 1 << 40)
    plan = object.__new__(Plan)
    assert card.memory_error(plan, SerialCommunicator()) == ""
    assert "has" in card.memory_error(plan, _Two())


def test_a_card_that_fails_is_named(monkeypatch):
    class Failed(Exception):
        pass

    class Engine:
        step_number = 7

        @card.with_device_context
        def fill(self):
            raise Failed("an illegal memory access was encountered")

    monkeypatch.setattr(card, "FAILURES", (Failed,))
    card.select_device(0, rank=3)
    monkeypatch.setattr(card, "LAST", ["g2p"])
    with pytest.raises(RuntimeError, match="card of rank 3 failed in step 7, at kernel g2p") as it:
        Engine().fill()
    assert "illegal memory access" in str(it.value)
