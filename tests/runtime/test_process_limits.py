"""Limits and variables with which nothing works are one line and exit code 2, before anything."""

import resource
import sys

import pytest

from tests.support.launch import run
from vgmpi.commands import command_table
from vgmpi.runtime import process_limits


@pytest.mark.parametrize("text", ["0", "-2", "two", ""])
def test_a_number_of_threads_that_is_none(text, monkeypatch, capsys):
    monkeypatch.setenv("NUMBA_NUM_THREADS", text)
    assert command_table.main(["scene.toml"]) == 2
    wanted = f"vgmpi: NUMBA_NUM_THREADS: must be a whole number of at least 1; got {text!r}\n"
    assert capsys.readouterr().err == wanted


def test_a_small_address_space():
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (150 << 20,) * 2);"
        " from vgmpi.__main__ import main; sys.argv[1:] = ['scene.toml']; sys.exit(main())"
    )
    job = run([sys.executable, "-c", code])
    assert job.returncode == 2
    wanted = "vgmpi: the address space is limited to 150 MiB (ulimit -v): at least 1024 MiB are"
    assert job.stderr == f"{wanted} needed\n"


def test_no_limit_is_no_problem(monkeypatch):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert process_limits.find_unusable_limit() == ""
