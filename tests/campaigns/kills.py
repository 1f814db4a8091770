"""SIGKILL at random moments: of a rank, of mpirun, of all; then the run goes on to the same bits.

After each: no process of it is left, what lies in the folder under its own name is whole, and the
run continued on one rank ends with the files of one that was not killed. Some are killed again
while they go on.
"""

import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import numpy as np

from tests.campaigns import cases, tiny
from tests.campaigns.result import Result
from tests.support.launch import PATIENCE, finish, on_ranks, start, until
from vgmpi.io import file_layout

NAME, COUNT, SMALL = "kills", 100, 3
MARKS = ("mpi",)
MARK = "VGMPI_CAMPAIGN"  # in the environment of all that a case starts


def campaign(count: int, seed: int, folder: Path) -> Result:
    with tiny.undisturbed() as (scene, want):
        seconds = _set_up(scene, scene.parent / "two", want)

        def case(k: int, random: np.random.Generator, own: Path) -> str:
            target, ranks = ("rank", "mpirun", "all")[k % 3], 1 if k % 7 == 6 else 2
            lives, said = 2 if k % 4 == 3 else 1, ""
            for _ in range(lives):
                said = _life(_command(ranks, scene, own / "out"), target, random, own, seconds)
            return f"{target if ranks > 1 else 'one rank'} {said}, {_after(scene, own, want)}"

        return cases.each(count, seed, folder, case)


def _set_up(scene: Path, out: Path, want: dict[str, bytes]) -> float:
    """A run on two ranks, which compiles what one rank has no need of; seconds until it has its
    folder."""
    begin = time.monotonic()
    process = start(_command(2, scene, out))
    until(lambda: (out / file_layout.LOCK).exists() or process.poll() is not None, "a run begins")
    seconds = time.monotonic() - begin
    job = finish(process)
    assert job.returncode == 0, job.stderr
    assert tiny.different(out, want) == [], "two ranks"
    return seconds


def _command(ranks: int, scene: Path, out: Path) -> list:
    """A run, or its continuation where there is a checkpoint."""
    how = "--resume" if tiny.manifests(out) else "--overwrite"
    flags = ["-m", "vgmpi", scene, "-q", "-o", out, how]
    return [sys.executable, *flags] if ranks == 1 else on_ranks(ranks, *flags)


def _life(command: list, target: str, random: np.random.Generator, own: Path, seconds: float):
    """Start it, kill it, wait until nothing of it is left; what it was at."""
    out, mark = own / "out", uuid.uuid4().hex
    before = len(list(out.glob("frames/*.vtkhdf")))
    process = start(command, env={MARK: mark})
    try:
        wait_for_moment(process, out, random, seconds)
        seen = set(_kill(process, target, mark, random))
        code = process.wait(PATIENCE)
        until(lambda: not is_left(seen, mark), f"what was left of it ends: {sorted(seen)}")
    finally:
        for pid in _marked(mark):  # only where the case failed
            _end(pid)
        (own / "stderr.txt").write_text(process.communicate()[1])
    if code == 0:
        return "too late"
    if list(out.rglob("*.tmp")):
        return "writing"
    return "running" if len(list(out.glob("frames/*.vtkhdf"))) > before else "in set-up"


def wait_for_moment(
    process: subprocess.Popen, out: Path, random: np.random.Generator, seconds: float
):
    """To any moment, or for a file and a little longer: most of what can go wrong is near one."""
    frames = [
        f"{file_layout.FRAMES}/{file_layout.FRAME_NAME.format(k)}" for k in range(tiny.FRAMES)
    ]
    steps = range(tiny.EVERY, 110, tiny.EVERY)
    kept = [f"{file_layout.CHECKPOINTS}/{file_layout.CHECKPOINT_NAME.format(k)}" for k in steps]
    if random.random() < 0.35:
        time.sleep(random.uniform(0, 1.5 * seconds))
        return
    path = out / random.choice([file_layout.LOCK, file_layout.GAUSSIANS, *frames, *kept])
    after = random.uniform(0, 0.06)
    until(lambda: path.exists() or process.poll() is not None, f"{path} is written")
    time.sleep(after)


def _kill(
    process: subprocess.Popen, target: str, mark: str, random: np.random.Generator
) -> list[int]:
    """A rank that is there, or all that is there, or what was started. All that were there."""
    there = _marked(mark)
    ranks = [pid for pid in there if pid != process.pid]
    if target == "rank" and ranks:
        _end(int(random.choice(ranks)))
    elif target == "all":
        for pid in there:
            _end(pid)
    else:
        process.kill()
    return there


def _end(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        pass  # it ended by itself


def _marked(mark: str) -> list[int]:
    """Processes that have the mark in their environment."""
    word, found = f"{MARK}={mark}".encode(), []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if word in path.read_bytes().split(b"\0"):
                found.append(int(path.parent.name))
        except OSError:
            continue  # it ended, or is another user's
    return sorted(found)


def is_left(seen: set[int], mark: str) -> bool:
    """Whether anything of it lives. A process that ends loses its environment first and its files,
    with the lock, after that; then it is a zombie until its parent asks, with all its threads.
    """
    seen |= set(_marked(mark))
    for pid in seen:
        for path in Path(f"/proc/{pid}/task").glob("*/stat"):
            try:
                if path.read_text().rpartition(")")[2].split()[0] not in "ZX":
                    return True
            except OSError:
                continue
    return False


def _after(scene: Path, own: Path, want: dict[str, bytes]) -> str:
    tiny.check(own / "out")
    return tiny.ends_the_same(scene, own / "out", want)
