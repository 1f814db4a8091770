"""The numbers that the first tutorial prints are those of the program today.

The lines to paste: .venv/bin/python -m tests.docs.test_tutorial_numbers
"""

import re
import tempfile
from pathlib import Path

import pytest

from vgmpi.commands.start import choose_ranks
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.cost.throughput import Throughput
from vgmpi.scene.loader import load
from vgmpi.solver.initial_particles import plan_for, prepare

PAGE = Path(__file__).parents[2] / "docs" / "tutorial" / "first-scene.md"
MAX_STEP_ERROR = 0.1  # [-] of the number of steps


def blocks(kind: str) -> list[str]:
    """The fenced blocks of a kind on the page."""
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


def plan_of_the_page(folder: Path) -> list[str]:
    """The lines that `vgmpi plan` prints of the page's scene on two cores, without its time."""
    path = folder / "scene.toml"
    path.write_text(next(text for text in blocks("toml") if "[domain]" in text), encoding="utf-8")
    scene = load(path)
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    choice = choose_ranks(scene, 2)
    why = f"{choice.ranks} of 2 cores: {choice.reason.removesuffix(' (plan)')}"
    pace = Throughput(40.0, 42.0, "of none")
    return format_plan(scene, plan, choice.ranks, pace=pace, choice=why).splitlines()


def steps_of(lines: list[str]) -> int:
    """The number of steps that is told."""
    (found,) = re.findall(r"^  steps +about ([\d,]+) for 0.8 s", "\n".join(lines), re.M)
    return int(found.replace(",", ""))


def test_the_plan_is_that_of_the_program(tmp_path):
    """All but the time, which is that of a processor; a pilot run changes the steps a little."""
    (page,) = (text.splitlines() for text in blocks("text") if "  steps  " in text)
    today = plan_of_the_page(tmp_path)
    assert steps_of(page) == pytest.approx(steps_of(today), rel=MAX_STEP_ERROR)
    others = [line for line in page if not line.startswith(("  time    ", "  steps "))]
    assert others and [line for line in others if line not in today] == []


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print("\n".join(plan_of_the_page(Path(folder))[:7]))
