"""The parts `make test` and `make check`, the costs of each test, and what commands that ran in the
tests' own process have set for the life of a program."""

import logging
import signal

import pytest

from tests.support import long_tests
from tests.support.cost_counter import COSTS, count_processes

SIGNALS = (signal.SIGUSR1, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)
# who runs all this under `nohup` has SIGHUP ignored, which every process inherits
for _number in SIGNALS:
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)
HEARD = {s: signal.getsignal(s) for s in SIGNALS}
# and behind `&` in a script SIGINT
HEARD[signal.SIGINT] = signal.default_int_handler

count_processes()


def pytest_addoption(parser):
    """Add the option that splits the tests between `make test` and `make check`."""
    text = "tests that tests/long_tests.txt does not name (quick), or the others (rest)"
    parser.addoption("--part", choices=long_tests.PARTS, help=text)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Keep the tests of the part that is asked for; before -k and -m take any away."""
    part = config.getoption("--part")
    if part is None:
        return
    names, tests = long_tests.read_names(), [item.nodeid for item in items]
    has_whole_files = not config.getoption("lf", False) and not any("::" in a for a in config.args)
    unknown = long_tests.find_unknown_names(names, tests, config.rootpath)
    if unknown and has_whole_files:
        text = f"names no test: {', '.join(unknown)}"  # a report, which processes of xdist pass on
        report = pytest.CollectReport("tests/long_tests.txt", "failed", text, [])
        config.hook.pytest_collectreport(report=report)
    chosen = long_tests.select_part(tests, part, names)
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in chosen])
    items[:] = [item for item in items if item.nodeid in chosen]


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
