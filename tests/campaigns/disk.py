"""A disk that is full after so many bytes: the run says so and ends; with room it goes on.

A small file system in memory stands for the disk, which takes root. The line is one, with "no
space left"; what lies there under its own name is whole; made larger, the run goes on to the same
files.
"""

import os
import shutil
import sys
from pathlib import Path

import numpy as np

from tests.campaigns import cases, tiny
from tests.campaigns.result import Result
from tests.support.launch import on_ranks, run
from tests.support.small_disk import mount, small_disk

NAME, COUNT, SMALL = "disk", 40, 4
MARKS = ("mpi",)
PAGE = os.sysconf("SC_PAGE_SIZE")  # what such a file system counts in


def campaign(count: int, seed: int, folder: Path) -> Result:
    with tiny.undisturbed() as (scene, want):
        with small_disk(folder / "disk", PAGE):
            pass  # or it says why not
        most = 1.2 * sum(map(len, want.values())) / PAGE

        def case(k: int, random: np.random.Generator, own: Path) -> str:
            """Sizes are spread over the run, the first is nothing at all."""
            pages = int(most * (k + random.random()) / count) if k else 0
            ranks = 2 if shutil.which("mpirun") and k % 3 == 1 else 1
            with small_disk(own / "disk", (pages + 1) * PAGE) as disk:
                (disk / "others").write_bytes(b"x" * PAGE)  # a disk of no pages would have no end
                try:
                    return _case(scene, disk, ranks, want)
                except BaseException:
                    shutil.copytree(disk / "out", own / "out")
                    raise

        return cases.each(count, seed, folder, case)


def _case(scene: Path, disk: Path, ranks: int, want: dict[str, bytes]) -> str:
    flags = ["-m", "vgmpi", scene, "-q", "-o", disk / "out"]
    job = run([sys.executable, *flags] if ranks == 1 else on_ranks(ranks, *flags))
    if job.returncode == 0:
        assert tiny.different(disk / "out", want) == []
        return "enough"
    ours = [line for line in job.stderr.splitlines() if line.startswith("vgmpi: ")]
    assert job.returncode == 1 and "Traceback" not in job.stderr, job.stderr
    assert len(ours) == 1 and "no space left" in ours[0], job.stderr
    if ranks == 1:  # mpirun has lines of its own
        assert job.stderr.splitlines() == ours
    tiny.check(disk / "out")
    assert not list(disk.rglob("*.tmp")), "half a file is left"
    mount(f"remount,size={64 << 20}", disk)
    return f"full, {tiny.ends_the_same(scene, disk / 'out', want)}"
