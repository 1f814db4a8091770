"""Processor time of a frame and of the series over all frames, which every frame writes anew.

With another checkout both take turns in processes of their own, and the bytes are compared.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tests.support.launch import ROOT
from vgmpi.io import file_layout
from vgmpi.io.frames import Frames
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.tools.bench.benchmark_case import BenchError

TIMED = 5  # times that each is written; the least counts
MOVE = np.float32(0.01)  # [m] by which positions differ from frame to frame


def time_frames(particles: int, frames: int) -> dict:
    """Write frames of made-up particles; return times [s] and the sums of the bytes.

    Args:
        particles: Number of particles.
        frames: Number of frames that the series holds at last.
    """
    random = np.random.default_rng(1)
    ids = random.permutation(particles)
    positions = file_layout.FRAME[1].name  # "x" in older checkouts
    fields = {
        positions: random.random((particles, 3), np.float32),
        "velocity": random.random((particles, 3), np.float32),
        "J": random.random(particles, np.float32),
        "F": random.random((particles, 9), np.float32),
        "object": np.zeros(particles, np.int32),
        "phase": np.zeros(particles, np.int32),
    }
    with tempfile.TemporaryDirectory(prefix="vgmpi-frames-") as folder:
        writer = Frames(folder, SerialCommunicator(), particles)
        write_series, spent, series = writer._write_series, [], []
        writer._write_series = lambda: None
        for k in range(TIMED):
            fields[positions] += MOVE
            begin = time.process_time()
            writer.write(k, 0.1 * k, k, ids, fields)
            spent.append(time.process_time() - begin)
        last = writer._written[0]
        for k in range(TIMED, frames):  # as if they had been written
            writer._written[k] = last._replace(file=f"frame_{k:05d}.vtkhdf", time=0.1 * k, step=k)
        for _ in range(TIMED):
            begin = time.process_time()
            write_series()
            series.append(time.process_time() - begin)
        files = sorted(path for path in Path(folder).rglob("*.vtkhdf"))
        sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    return {"frame": min(spent), "series": min(series), "files": sums}


def compare_frames(
    tree: Path | None, particles: int, counts: list[int], rounds: int, say: Callable
) -> Iterator[str]:
    """Yield a row per length of the series: times of this program, and of another checkout.

    Args:
        tree: The other checkout, or None.
        particles: Number of particles.
        counts: Frames that the series holds.
        rounds: Number of rounds.
        say: Called with a line of progress.

    Raises:
        BenchError: If a checkout cannot write frames.
    """
    trees = [ROOT] + ([] if tree is None else [tree.resolve()])
    yield f"{particles:,} particles: processor time of a frame, and of the series [ms]"
    for count in counts:
        found: dict[Path, list[dict]] = {each: [] for each in trees}
        for k in range(rounds):
            for each in trees if k % 2 else trees[::-1]:
                found[each].append(_measure(each, particles, count))
            say(f"{count} frames, round {k + 1} of {rounds}")
        words = []
        for results in found.values():
            frame, series = (
                1e3 * min(result[name] for result in results) for name in ("frame", "series")
            )
            words.append(f"{frame:.1f}, {series:.1f}")
        same = len({tuple(result["files"]) for rows in found.values() for result in rows}) == 1
        yield f"  {count:5d} frames: {'; other: '.join(words)}; " + (
            "the same bytes" if same else "OTHER BYTES"
        )


def _measure(tree: Path, particles: int, frames: int) -> dict:
    """Return what time_frames returns in a process that imports another checkout."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    job = subprocess.run(
        [sys.executable, __file__, str(particles), str(frames)], env=environment, cwd=tree,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if job.returncode:
        raise BenchError(f"{tree}: {(job.stderr.splitlines() or ['failed'])[-1]}")
    return json.loads(job.stdout.splitlines()[-1])


if __name__ == "__main__":
    print(json.dumps(time_frames(int(sys.argv[1]), int(sys.argv[2]))))
