"""The parts `make test` and `make check`, the costs of each test, and what commands that ran in the
tests' own process have set for the life of a program."""

import gc
import logging
import signal

import pytest

from tests.support import long_tests
from tests.support.cost_counter import COSTS, count_processes, processor_seconds
from vgmpi.__main__ import NEW_OBJECTS

SIGNALS = (signal.SIGUSR1, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)
# who runs all this under `nohup` has SIGHUP ignored, which every process inherits
for _number in SIGNALS:
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)
HEARD = {s: signal.getsignal(s) for s in SIGNALS}
# and behind `&` in a script SIGINT
HEARD[signal.SIGINT] = signal.default_int_handler
NEGLIGIBLE = 0.005  # [s] of processor time: what a phase may spend untold

count_processes()
gc.set_threshold(NEW_OBJECTS)  # as in the program


def pytest_addoption(parser):
    """Add the option that splits the tests between `make test` and `make check`."""
    text = "tests that tests/long_tests.txt does not name (quick), or the others (rest)"
    parser.addoption("--part", choices=long_tests.PARTS, help=text)


def pytest_ignore_collect(collection_path, config):
    """Leave files of which the list names no test: reading all takes half a minute."""
    if config.getoption("--part") == "rest" and collection_path.suffix == ".py":
        files = {config.rootpath / name.partition("::")[0] for name in long_tests.read_names()}
        return True if collection_path not in files else None
    return None


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
    if part == "rest":
        items.sort(key=lambda item: long_tests.begins(item.nodeid))


def pytest_collection_finish(session):
    """Count from here on; what collecting made is never searched for cycles."""
    gc.collect()
    gc.freeze()
    session.config._costs_before = *COSTS(), processor_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Write what each phase of a test compiles, starts and computes into the report."""
    costs = *COSTS(), processor_seconds()
    before, item.config._costs_before = item.config._costs_before, costs
    compiling, processes, computing = (now - then for now, then in zip(costs, before))
    if processes or computing > NEGLIGIBLE:
        text = f"{compiling:.2f} {processes} {computing:.2f}"
        item.user_properties.append((f"costs {call.when}", text))
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
