"""What tests that call the command line in their own process need."""

import logging
import signal

import pytest


@pytest.fixture(autouse=True)
def leave_no_trace():
    """main() sets up the log and listens to signals for the life of a program."""
    log = logging.getLogger("vgmpi")
    before = log.handlers[:], log.level, log.propagate
    heard = [signal.getsignal(s) for s in (signal.SIGUSR1, signal.SIGTERM)]
    yield
    log.handlers[:], log.propagate = before[0], before[2]
    log.setLevel(before[1])
    signal.signal(signal.SIGUSR1, heard[0])
    signal.signal(signal.SIGTERM, heard[1])
