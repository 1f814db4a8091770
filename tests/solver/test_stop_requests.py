"""Signals before the first step end a run soon, and later ones ask for a checkpoint."""

import os
import signal
import sys
import time

import pytest

from tests.support.launch import finish, run, start
from tests.support.small_scenes import MIXED, write
from vgmpi.solver.stop_requests import (
    EndedBySignalError,
    Requests,
    begin_steps,
    hold_ending_signals,
    signals_heard,
    stop_signal_held,
    take_ending_signals,
)

ENDING = [signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU]
# compiled code that does not return for minutes; Python's handlers cannot run
BUSY = """
import hashlib, logging, threading
from vgmpi.solver.stop_requests import signals_heard
logging.getLogger("vgmpi").setLevel(LEVEL)
with signals_heard():
    threading.Timer(0.5, print, ["ready"], {"flush": True}).start()  # while it computes
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
"""
# a run that gets SIGUSR1 while its module is loaded
EARLY = """
import importlib, os, signal, sys
from vgmpi.commands import command_table
load = importlib.import_module
def load_late(name, package=None):
    if name == "vgmpi.commands.cli":
        os.kill(os.getpid(), signal.SIGUSR1)
    return load(name, package)
importlib.import_module = load_late
sys.exit(command_table.main(sys.argv[1:]))
"""


@pytest.mark.parametrize("number", ENDING)
def test_before_the_first_step_it_ends_the_run(number):
    before = signal.getsignal(number)
    with pytest.raises(EndedBySignalError) as end, signals_heard():
        signal.raise_signal(number)
    assert end.value.code == 128 + number
    assert end.value.line == f"{number.name} before the first step: the run ends, nothing is kept"
    assert signal.getsignal(number) == before


@pytest.mark.parametrize("number", ENDING)
def test_then_it_asks_for_a_stop(number, caplog):
    with signals_heard(), caplog.at_level("INFO", "vgmpi"):
        begin_steps()
        requests = Requests()
        assert requests.poll(1) == (0.0, 0.0)
        signal.raise_signal(number)
        assert requests.poll(2) == requests.poll(3) == (number, 0.0)
        requests.log_stop(number)
    assert caplog.messages == [f"{number.name}: stops with a checkpoint"]


def test_a_signal_that_came_to_another_rank_first_is_told(caplog):
    with signals_heard(), caplog.at_level("INFO", "vgmpi"):
        requests = Requests(stop_steps=3)
        assert requests.poll(2)[0] == 0.0 < requests.poll(3)[0] < 1.0
        requests.log_stop(0.0)
        requests.log_stop(requests.poll(3)[0])
        assert not caplog.messages
        requests.log_stop(float(signal.SIGTERM))
        requests.log_stop(float(signal.SIGTERM))
    assert caplog.messages == ["SIGTERM: stops with a checkpoint"]


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_that_is_held_ends_the_run_when_it_is_taken(number):
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        hold_ending_signals()
        signal.raise_signal(number)
        with signals_heard(), pytest.raises(EndedBySignalError):
            take_ending_signals()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def test_usr1_is_kept_for_the_first_step():
    with signals_heard():
        signal.raise_signal(signal.SIGUSR1)
        begin_steps()
        assert Requests().poll(1) == (signal.SIGUSR1, 0.0)
    with signals_heard():
        assert Requests().poll(1) == (0.0, 0.0), "of the run before"


def test_usr1_is_held_for_a_run_that_starts():
    with stop_signal_held():
        signal.raise_signal(signal.SIGUSR1)
        with signals_heard():
            begin_steps()
            assert Requests().poll(1) == (signal.SIGUSR1, 0.0)
        signal.raise_signal(signal.SIGUSR1)  # behind the last step
    assert signal.SIGUSR1 not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", ["1", "2"])
def test_usr1_before_the_program_is_loaded_stops_with_a_checkpoint(ranks, tmp_path):
    scene = write(tmp_path, MIXED.replace("PRECISION", "single"))
    out = tmp_path / "out"
    job = run([sys.executable, "-c", EARLY, str(scene), "--ranks", ranks, "-o", str(out)])
    assert job.returncode == 75, job.stderr
    assert "stopped; go on with --resume" in job.stdout
    assert len(list((out / "checkpoints").glob("*.h5"))) == 1


def test_what_nohup_ignores_stays_ignored():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with signals_heard():
        signal.raise_signal(signal.SIGHUP)
        begin_steps()
        assert Requests().poll(1) == (0.0, 0.0)


@pytest.mark.parametrize("number", [*ENDING, signal.SIGINT])
def test_compiled_code_does_not_hold_it_up(number):
    process = start([sys.executable, "-c", BUSY.replace("LEVEL", "0")])
    assert process.stdout.readline() == "ready\n"
    begin = time.monotonic()
    process.send_signal(number)
    job = finish(process)
    assert job.returncode == 128 + number and time.monotonic() - begin < 60
    line = f"vgmpi: {number.name} before the first step: the run ends, nothing is kept\n"
    assert job.stderr == ("" if number == signal.SIGINT else line)


def test_only_the_first_rank_says_it():
    process = start([sys.executable, "-c", BUSY.replace("LEVEL", "51")])
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGTERM)
    job = finish(process)
    assert job.returncode == 143 and job.stderr == ""


def test_a_forked_child_has_no_part_in_it():
    with signals_heard():
        child = os.fork()
        if child == 0:
            signal.signal(signal.SIGTERM, lambda *_: os._exit(7))
            os.kill(os.getpid(), signal.SIGTERM)
            os._exit(8)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        time.sleep(3)  # longer than the grace in which this process would be ended
