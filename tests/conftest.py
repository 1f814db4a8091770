"""What commands that ran in the tests' own process have set for the life of a program."""

import logging
import signal

import pytest

from tests.support.cost_counter import COSTS, count_processes

HEARD = {s: signal.getsignal(s) for s in (signal.SIGUSR1, signal.SIGTERM)}
# who runs all this behind `&` in a script has it ignored, which every process inherits
HEARD[signal.SIGINT] = signal.default_int_handler

count_processes()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Write what each phase of a test compiles and starts into the report."""
    seconds, processes = COSTS()
    before = getattr(item.config, "_costs_before", (0.0, 0))
    item.config._costs_before = (seconds, processes)
    spent = seconds - before[0], processes - before[1]
    if any(spent):
        item.user_properties.append((f"costs {call.when}", f"{spent[0]:.2f} {spent[1]}"))
    return (yield)


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
