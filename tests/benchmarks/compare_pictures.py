"""Pictures of a run in this program and in another checkout: processor time, in turns, and how
much the pictures differ.

Each checkout draws the same frames of the same run with the same settings, in a process of its own.
The first picture, which compiles, is not counted.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.tools.bench.benchmark_case import BenchError

# runs in each checkout, the other of which may be an older one
DRAW = """
import json, sys, time
from pathlib import Path
import numpy as np
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
run, settings, to, *frames = sys.argv[1:]
chosen = render_config.load(settings)
renderer = FrameRenderer(RunReader(run), chosen, Path(settings).parent)
renderer.draw(int(frames[0]))
renderer = FrameRenderer(RunReader(run), chosen, Path(settings).parent)
begin = time.process_time()
getattr(renderer.studio, "bodies", None)
prepared = time.process_time() - begin
renderer.draw(int(frames[0]))
begin = time.process_time()
pictures = [renderer.draw(int(k)) for k in frames]
seconds = (time.process_time() - begin) / len(frames)
np.save(to, np.array(pictures))
print(json.dumps([prepared, seconds]))
"""
ROOT = Path(__file__).parents[2]


def draw(tree: Path, run: Path, settings: Path, frames: list[int], to: Path) -> Any:
    """Draw frames with a checkout.

    Args:
        tree: Folder of the checkout.
        run, settings: Folder of the run, and its render.toml.
        frames: Numbers of the frames.
        to: File for the pictures.

    Returns:
        Processor time [s] of what is prepared once, and of a frame.

    Raises:
        BenchError: If the checkout cannot draw them.
    """
    words = map(str, (run.resolve(), settings.resolve(), to, *frames))
    single = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(tree)}
    job = subprocess.run(
        [sys.executable, "-c", DRAW, *words],
        cwd=tree, env={**os.environ, **single}, capture_output=True, text=True,
    )  # fmt: skip
    if job.returncode:
        raise BenchError(f"{tree}: {(job.stderr.splitlines() or ['failed'])[-1]}")
    return json.loads(job.stdout.splitlines()[-1])


def compare(
    tree: Path, run: Path, settings: Path, frames: list[int], rounds: int, tell: Callable
) -> Iterator[str]:
    """Yield lines: least times of both, their ratio, and differences of the pictures.

    Args:
        tree: Folder of the other checkout.
        run, settings, frames: See `draw`.
        rounds: Number of turns.
        tell: Called with a line of progress.
    """
    seconds: dict[Path, list] = {ROOT: [], tree.resolve(): []}
    with tempfile.TemporaryDirectory(prefix="vgmpi-pictures-") as folder:
        files = {t: Path(folder) / f"{k}.npy" for k, t in enumerate(seconds)}
        for k in range(rounds):
            for t in list(seconds)[:: 1 if k % 2 == 0 else -1]:
                seconds[t].append(draw(t, run, settings, frames, files[t]))
                tell(f"{t}: prepared {seconds[t][-1][0]:.2f} s, a frame {seconds[t][-1][1]:.2f} s")
        ours, theirs = (np.load(files[t]).astype(int) for t in seconds)
    (own_start, own), (other_start, other) = (np.min(seconds[t], axis=0) for t in seconds)
    yield f"a frame: {own:.2f} s, other {other:.2f} s, ratio {own / other:.2f}"
    yield f"prepared once: {own_start:.2f} s, other {other_start:.2f} s"
    difference = np.abs(ours - theirs)
    share = (difference.max(axis=-1) > 8).mean()
    yield (
        f"levels of 255: mean difference {difference.mean():.3f}, largest {difference.max()},"
        f" above 8 in {100 * share:.2f} % of the pixels"
    )
