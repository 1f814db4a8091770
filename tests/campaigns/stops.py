"""SIGHUP (a closed terminal), SIGXCPU (a limit of processor time) and SIGTERM at random moments, to
a run on one rank and to one that has started its two ranks by itself.

After each: exit code 75 with a checkpoint where steps were made, 128 + the signal and a line before
that; no traceback; the run goes on to the same bits, and no process of it is left.
"""

import signal
import sys
import time
import uuid
from pathlib import Path

import numpy as np

from tests.campaigns import cases, kills, tiny
from tests.campaigns.result import Result
from tests.support.launch import finish, start, until

NAME, COUNT, SMALL = "stops", 24, 3
MARKS = ("mpi",)
SIGNALS = (signal.SIGHUP, signal.SIGXCPU, signal.SIGTERM)


def campaign(count: int, seed: int, folder: Path) -> Result:
    with tiny.undisturbed() as (scene, want):
        seconds = {}
        for ranks in (1, 2):
            begin, out = time.monotonic(), scene.parent / f"alone{ranks}"
            job = finish(start(_command(scene, out, ranks)))
            seconds[ranks] = time.monotonic() - begin
            assert job.returncode == 0, job.stderr
            assert tiny.different(out, want) == []

        def case(k: int, random: np.random.Generator, own: Path) -> str:
            number, ranks, out = SIGNALS[k % 3], 1 + k // 3 % 2, own / "out"
            mark = uuid.uuid4().hex
            process = start(_command(scene, out, ranks), env={kills.MARK: mark})
            kills.wait_for_moment(process, out, random, seconds[ranks])
            process.send_signal(number)
            job = finish(process)
            (own / "stderr.txt").write_text(job.stderr)
            until(lambda: not kills.is_left(set(), mark), "all processes of it end")
            said = _outcome(job, number, out)
            tiny.check(out)
            return (
                f"{number.name}, {said}, {tiny.ends_the_same(scene, out, want, said == 'stopped')}"
            )

        return cases.each(count, seed, folder, case)


def _command(scene: Path, out: Path, ranks: int) -> list:
    return [sys.executable, "-m", "vgmpi", scene, "-o", out, "--ranks", ranks]


def _outcome(job, number: signal.Signals, out: Path) -> str:
    """What the run did; raises AssertionError where it did not say so or did not do it."""
    assert "Traceback" not in job.stderr, job.stderr
    if job.returncode == 0:
        return "too late"
    if job.returncode == 75:
        assert f"{number.name}: stops with a checkpoint" in job.stderr, job.stderr
        assert tiny.manifests(out), "no checkpoint"
        return "stopped"
    if job.returncode == -number:
        return "while it loads"  # no handler is there yet
    assert job.returncode == 128 + number, (job.returncode, job.stderr)
    assert job.stderr.count(f"{number.name} before the ") == 1, job.stderr
    return "before the first step"
