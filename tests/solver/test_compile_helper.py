"""Processes that compile beside a run of one rank."""

import io
import os
import pickle
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.solver import compile_helper, compile_kernels

# writes its number and its arguments, then waits to be ended
NOTES = (
    "import os, pickle, sys, time; plan = pickle.load(sys.stdin.buffer);"
    "part = plan + '.part'; file = open(part, 'w');"
    "file.write(f'{os.getpid()} {sys.argv[1:]}'); file.close(); os.replace(part, plan);"
    "time.sleep(60)"
)


def wait_for(path):
    end = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.02)
    return path.read_text()


def test_a_helper_gets_the_plan_and_ends_with_the_block(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_helper, "PROGRAM", (sys.executable, "-c", NOTES))
    with compile_helper.helpers_of(str(tmp_path / "noted"), 1):
        number, arguments = wait_for(tmp_path / "noted").split(" ", 1)
        os.kill(int(number), 0)
    assert arguments == "['1', '2']"
    with pytest.raises(ProcessLookupError):
        os.kill(int(number), 0)


@pytest.mark.parametrize("program", ["/no/such/program", "false"])
def test_a_helper_that_fails_is_done_without(program, monkeypatch):
    monkeypatch.setattr(compile_helper, "PROGRAM", (program,))
    with compile_helper.helpers_of("x" * 10**6, 2):
        pass


def test_it_compiles_its_share(monkeypatch):
    seen = []
    monkeypatch.setattr(compile_kernels, "compile_share", lambda *share: seen.append(share))
    monkeypatch.setattr(compile_helper.logging, "disable", lambda: None)
    monkeypatch.setattr(sys, "argv", ["", "2", "4"])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(pickle.dumps("plan"))))
    compile_helper.main()
    assert seen == [("plan", 2, 4, False)]


@pytest.mark.parametrize(
    "ranks, cores, count", [(1, 1, 0), (1, 2, 1), (1, 4, 3), (1, 64, 3), (2, 4, 0)]
)
def test_helpers_take_idle_cores_of_a_single_rank(ranks, cores, count, monkeypatch):
    monkeypatch.setattr(compile_helper, "physical_cores", lambda: cores)
    assert compile_helper.count_helpers(ranks) == count


@pytest.mark.parametrize("is_compiled", [True, False])
def test_a_run_has_them_until_its_kernels_are_compiled(is_compiled, tmp_path, monkeypatch):
    marker, events = tmp_path / "marker", []
    if is_compiled:
        marker.touch()

    class Helpers:
        def __init__(self, plan, count):
            events.append(count)

        def __enter__(self):
            pass

        def __exit__(self, *_):
            events.append("over")

    for name, value in {
        "compiled_marker": lambda *_: marker,
        "helpers_of": Helpers,
        "count_helpers": lambda ranks: 1,
        "compile_share": lambda plan, *share: events.append(share),
        "_failure_of_run": lambda plan: events.append("step") or "",
    }.items():
        monkeypatch.setattr(compile_kernels, name, value)
    plan = SimpleNamespace(groups=(), real=np.dtype(np.float32))
    compile_kernels.compile_kernels(plan, SerialCommunicator())
    first = [0, "step"] if is_compiled else [1, (0, 2, True), "step"]
    assert events == [*first, "over"] and marker.exists()
