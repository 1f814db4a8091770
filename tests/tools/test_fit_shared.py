"""Several processes on one fit: the same bits as one alone, and no run is made twice, also where
one of them is killed."""

import collections
import os
import sys

import pytest

from tests.support import launch
from tests.support.fit_scenes import FIT, bits, fitted_alone
from vgmpi.io.run_lock import file_lock
from vgmpi.scene.loader import load
from vgmpi.tools.fit import optimizers
from vgmpi.tools.fit.fit_config import FitFile
from vgmpi.tools.fit.parameter_space import setting
from vgmpi.tools.fit.run_pool import RECORD, RunPool

FEW = FIT.replace("max_runs = 40", "max_runs = 14")
# the command of a fit that notes each run it begins, stays in the one of a number for ever, and
# in all but the first of the fit waits until as many processes as are told have begun one
NOTED = """
import os, sys, time
from vgmpi.tools.fit import __main__ as fit, run_pool
log, stays, together = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
make, count = run_pool.RunPool._make, 0
def noted(self, setting, handle):
    global count
    count += 1
    with open(log, "a") as f:
        f.write(f"{self.place(setting).name} {os.getpid()} {'stays' if count == stays else ''}\\n")
    if count == stays:
        time.sleep(10000)
    while 1 < len(lines := open(log).readlines()) and len({x.split()[1] for x in lines}) < together:
        time.sleep(0.01)
    make(self, setting, handle)
run_pool.RunPool._make = noted
sys.exit(fit.main(sys.argv[4:]))
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A folder with a scene and a fit, and in it what one process alone made of them."""
    return fitted_alone(tmp_path_factory.mktemp("shared"), FEW)


def begun(folder, out, *flags, stays=0, together=1):
    """A process on the fit in `out`; the run of its own in which it stays; how many take part."""
    words = [sys.executable, "-c", NOTED, folder / f"{out}.log", stays, together]
    return launch.start(
        [*words, folder / "scene.toml", folder / "fit.toml", "-o", folder / out, *flags]
    )


def starts(folder, out):
    """Runs as they were begun: their folders and who began them."""
    path = folder / f"{out}.log"
    return [line.split() for line in path.read_text().splitlines()] if path.exists() else []


def ended(processes):
    for one in [launch.finish(one) for one in processes]:
        assert one.returncode == 0, one.stderr


@pytest.mark.parametrize("count, flags", [(2, ()), (3, ()), (2, ("--jobs", "2"))])
def test_several_at_once(alone, count, flags):
    out = f"{count}{''.join(flags)}"
    ended([begun(alone, out, *flags, together=count) for _ in range(count)])
    assert bits(alone / out) == bits(alone / "alone")
    made_, by = zip(*(line[:2] for line in starts(alone, out)))
    assert len(set(made_)) == len(made_) == len(bits(alone / out)[0])
    assert len(set(by)) == count  # and each had its share
    assert not list((alone / out).glob("**/*.lock")) and not list((alone / out).glob("*.tmp"))


def test_one_that_is_killed(alone):
    """In the middle of a run: the others wait for it as long as it lives, then make it anew."""
    victim = begun(alone, "killed", stays=2)
    launch.until(lambda: any(len(s) == 3 for s in starts(alone, "killed")), "the second run")
    others = [begun(alone, "killed") for _ in range(2)]
    launch.until(lambda: len(starts(alone, "killed")) >= 5, "the rest of the scan")
    kept = [line[0] for line in starts(alone, "killed")]
    assert all(one.poll() is None for one in others) and len(set(kept)) == len(kept)
    victim.kill()
    victim.communicate()
    ended(others)
    assert bits(alone / "killed") == bits(alone / "alone")
    times = collections.Counter(line[0] for line in starts(alone, "killed"))
    (lost,) = [line[0] for line in starts(alone, "killed") if len(line) == 3]
    assert {name for name, n in times.items() if n != 1} == {lost} and times[lost] == 2


def test_one_that_comes_late(alone):
    """To a fit that is done: it makes nothing, and leaves every record as it is."""
    out = alone / "alone"
    stamps = {p: p.stat().st_mtime_ns for p in out.glob(f"runs/*/{RECORD}")}
    before = bits(out)
    ended([begun(alone, "alone")])
    assert bits(out) == before and not starts(alone, "alone")
    assert stamps and all(os.stat(p).st_mtime_ns == stamp for p, stamp in stamps.items())


def test_a_record_is_looked_at_again_under_the_lock(alone, monkeypatch):
    """Another may have ended a run between the look at its record and the lock."""
    scene = load(alone / "scene.toml")
    file, runs = FitFile(alone / "fit.toml", scene), RunPool(scene, alone / "alone" / "runs")
    first = setting(file.axes, optimizers.start(file))
    monkeypatch.setattr(RunPool, "_make", lambda *_: pytest.fail("made again"))
    assert runs.done(first) and runs._claim(first)


def test_a_run_that_another_process_has_is_left_to_it(alone, monkeypatch):
    scene = load(alone / "scene.toml")
    file, runs = FitFile(alone / "fit.toml", scene), RunPool(scene, alone / "held")
    first, made_ = setting(file.axes, optimizers.start(file)), []
    monkeypatch.setattr(RunPool, "_make", lambda self, one, handle: made_.append(one))
    with file_lock(alone / "held" / f"{runs.place(first).name}.lock") as handle:
        assert handle is not None and not runs._claim(first) and not made_
    assert runs._claim(first) and made_ == [first]
