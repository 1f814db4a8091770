"""The path from the command to the time step is short, and the developer's page shows it."""

import re
import sys

from tests.house.source_file import ROOT
from tests.support.small_scenes import BALL, ROOM, write
from vgmpi.commands import command_table
from vgmpi.solver.run_outcome import BLEW_UP, BlowUp
from vgmpi.solver.simulation import Simulation

PAGE = ROOT / "docs" / "developer" / "developing.md"
MAX_CALLS, MAX_FILES = 5, 3


def find_path(tmp_path, monkeypatch):
    """Functions of vgmpi from the command to the step of a run, with their files."""
    frames = []

    def advance(*_):
        """Note who calls, and end the run."""
        frame = sys._getframe()
        while frame := frame.f_back:
            frames.append((frame.f_code.co_qualname, frame.f_code.co_filename))
        raise BlowUp("it was called")

    monkeypatch.setattr(Simulation, "advance", advance)
    words = [str(write(tmp_path, ROOM + BALL)), "--engine", "numpy", "--quiet"]
    assert command_table.main(words) == BLEW_UP
    path = [(name, file.removeprefix(f"{ROOT}/")) for name, file in reversed(frames)]
    command = command_table.COMMANDS["run"]
    first = (command.function, command.module.replace(".", "/") + ".py")
    step = ("Simulation.advance", "vgmpi/solver/simulation.py")
    return [*path[path.index(first) :], step]


def test_the_step_is_near_the_command(tmp_path, monkeypatch):
    path = find_path(tmp_path, monkeypatch)
    assert len(path) - 1 <= MAX_CALLS
    assert len({file for _, file in path}) <= MAX_FILES
    rows = re.findall(r"^\| `([\w.]+)` \| `(vgmpi/\S+\.py)` \|", PAGE.read_text(), re.MULTILINE)
    assert rows == path
