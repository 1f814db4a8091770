"""What commands that ran in the tests' own process have set for the life of a program."""

import logging
import signal

import pytest

HEARD = {s: signal.getsignal(s) for s in (signal.SIGUSR1, signal.SIGTERM)}
# who runs all this behind `&` in a script has it ignored, which every process inherits
HEARD[signal.SIGINT] = signal.default_int_handler


@pytest.fixture(autouse=True)
def as_in_a_new_process():
    """The log and the ear for signals, whatever ran before: another test, or a fixture of a module,
    which comes before any of a test."""
    log = logging.getLogger("vgmpi")
    log.handlers.clear()
    log.propagate = True
    log.setLevel(logging.NOTSET)
    for number, handler in HEARD.items():
        signal.signal(number, handler)
