"""A process that compiles what composes pictures of the studio, beside the first picture."""

import time
from pathlib import Path

import pytest
from numba.core import event

from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import frame_processes, render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.studio import compositing, liquid_radiance, spray_drops
from vgmpi.runtime import compiled_kernels

LAST = compositing.compose, liquid_radiance.find_surface, spray_drops.paint_drops


@pytest.fixture(scope="module")
def painter(tmp_path_factory):
    out = drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=2)
    return FrameRenderer(RunReader(out), render_config.load(None), Path("."), longest=60)


def test_it_compiles_what_a_picture_with_a_liquid_needs(painter):
    """The types of an empty studio are those of a full one: nothing more is compiled for it."""
    painter.warm_up()
    before = [set(function.overloads) for function in LAST]
    assert all(before)
    painter.draw(1)
    assert [set(function.overloads) for function in LAST] == before


@pytest.fixture
def fire(monkeypatch):
    """A function that does as numba does when it begins to compile."""
    listeners = []
    monkeypatch.setattr(compiled_kernels.event, "register", lambda _, one: listeners.append(one))
    started = event.Event("numba:compile", event.EventStatus.START)
    return lambda: [one.on_start(started) for one in listeners]


@pytest.mark.parametrize("cores, count", [(1, 0), (2, 1)])
def test_it_is_started_where_something_is_compiled(cores, count, painter, fire, monkeypatch):
    processes = []

    class Process:
        def __init__(self, target, args, daemon):
            assert target is frame_processes._draw_nothing and daemon
            assert args == (str(painter.run.folder), painter.chosen, Path("x"), True)
            processes.append([])

        def start(self):
            processes[-1].append("started")

        def kill(self):
            processes[-1].append("killed")

        def join(self):
            processes[-1].append("joined")

    class Context:
        def __init__(self, method):
            self.Process = Process

    monkeypatch.setattr(frame_processes.multiprocessing, "get_context", Context)
    monkeypatch.setattr(frame_processes, "physical_cores", lambda: cores)
    with frame_processes.compiled_beside(painter, Path("x")):
        assert processes == []
        fire()
        fire()
        assert processes == [["started"]] * count
    fire()
    assert processes == [["started", "killed", "joined"]] * count


def test_a_process_that_draws_nothing_ends_well(painter):
    begin = time.monotonic()
    process = frame_processes.multiprocessing.get_context("spawn").Process(
        target=frame_processes._draw_nothing,
        args=(str(painter.run.folder), painter.chosen, Path("."), True),
    )
    process.start()
    process.join(300)
    assert process.exitcode == 0, time.monotonic() - begin
