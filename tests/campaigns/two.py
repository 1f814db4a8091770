"""Two runs started into one folder, so long after each other: one runs, the other says why not.

Both are programs of their own. Half of the second ones would replace a run that lies there: they
may, once it has ended.
"""

import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.campaigns import cases, tiny
from tests.campaigns.result import Result
from tests.support.launch import finish, start

NAME, COUNT, SMALL = "two", 20, 3
REFUSED = re.compile(r"another run writes here now \(process (\d+) on (\S+), 1 ranks, since ")


def campaign(count: int, seed: int, folder: Path) -> Result:
    with tiny.undisturbed() as (scene, want):
        begin = time.monotonic()
        job = finish(_start(scene, scene.parent / "alone"))
        seconds = time.monotonic() - begin
        assert job.returncode == 0, job.stderr

        def case(k: int, random: np.random.Generator, own: Path) -> str:
            """Delays grow from nothing to a little more than a run takes."""
            out, delay = own / "out", 1.1 * seconds * (k + random.random() * (k > 0)) / count
            one = _start(scene, out)
            time.sleep(delay)
            other = _start(scene, out, *["--overwrite"][: k % 2])
            jobs = {process.pid: finish(process) for process in (one, other)}
            (own / "stderr.txt").write_text("".join(job.stderr for job in jobs.values()))
            said = _outcome(jobs, replaces=bool(k % 2))
            assert tiny.different(out, want) == []
            return said

        return cases.each(count, seed, folder, case)


def _start(scene: Path, out: Path, *flags: str) -> subprocess.Popen:
    return start([sys.executable, "-m", "vgmpi", scene, "-q", "-o", out, *flags])


def _outcome(jobs: dict[int, subprocess.CompletedProcess], replaces: bool) -> str:
    """jobs: by process. Raises AssertionError where not exactly one ran, or the other does not
    name it."""
    ran = [pid for pid, job in jobs.items() if job.returncode == 0]
    if len(ran) == 2 and replaces:
        return "replaced after its end"
    assert len(ran) == 1, [job.stderr for job in jobs.values()]
    (refused,) = (job for pid, job in jobs.items() if pid not in ran)
    assert refused.returncode == 2, refused.stderr
    (line,) = refused.stderr.splitlines()
    if f"a run lies here ({tiny.FRAMES} frames)" in line:
        return "refused after its end"
    named = REFUSED.search(line)
    assert named and (int(named[1]), named[2]) == (ran[0], socket.gethostname()), line
    return "refused"
