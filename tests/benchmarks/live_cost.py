"""What the live page costs: the delay from a frame's file to a viewer, and the slowdown of a run.

A viewer is a client of the page's web socket, as a browser is one; what a browser takes to draw is
not counted.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from tests.support import drawn_runs
from tests.support.launch import OPEN_MPI, ROOT
from tests.support.live_pages import ROW_BYTES, Viewer
from vgmpi.io import file_layout, initial_state
from vgmpi.io.frames import Frames
from vgmpi.parallel.communicator import SerialCommunicator

PACE = re.compile(r"steps of .* in ([\d.]+) s on")
SCENE = """
title = "A pool"
[accuracy]
pressure = "explicit"
[domain]
size = ["48 cm", "24 cm", "24 cm"]
cell = "1 cm"
[time]
end = "{end} s"
frames = {frames}
[material.water]
kind = "fluid"
density = 1000
[[object]]
name = "pool"
material = "water"
shape = {{ box = [[0, 0, 0], ["30 cm", "24 cm", "12 cm"]] }}
color = "#2040e0"
"""


class Delays(NamedTuple):
    """Seconds from the rename of each frame's file to the last byte of its Gaussians."""

    gaussians: int
    seconds: list[float]


class Slowdown(NamedTuple):
    """Seconds of the steps of a run without and with the page, in pairs."""

    without: list[float]
    having: list[float]
    page: list[float]  # processor time of the page in each run with it

    @property
    def ratios(self) -> list[float]:
        """How much longer each run with the page took than its partner."""
        return [b / a for a, b in zip(self.without, self.having)]


@contextmanager
def live_page(out: Path, *words: str) -> Iterator[str]:
    """A live page in a process of its own; yields the address of its web socket."""
    command = [sys.executable, "-m", "vgmpi", "live", str(out), "--port", "0", *words]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    job = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
    try:
        assert job.stdout is not None
        line = job.stdout.readline()
        yield re.sub(r".*http://localhost:(\d+)/.*\n", r"ws://127.0.0.1:\1/", line)
    finally:
        job.send_signal(signal.SIGINT)
        job.communicate()


def write_cloud(folder: Path, count: int, frames: int) -> list[Path]:
    """Write a run of `count` particles of a solid that moves; return the files of its frames."""
    rng = np.random.default_rng(0)
    rows = {
        "x0": rng.random((count, 3)),
        "vol0": np.full(count, 1e-6),
        "object": np.zeros(count, "i4"),
        "cov0": drawn_runs.diagonal(1e-5, 1e-5, 1e-5, count),
        "opacity": np.full(count, 0.8, "f4"),
        "sh": drawn_runs.sh(drawn_runs.RED, count),
    }
    objects = [{"name": "cloud", "family": "solid", "opacity_scale": 1.0, "alpha_min": None}]
    scene = {"domain": {"size": [1.0, 1.0, 1.0]}}
    ranks = SerialCommunicator()
    initial_state.write(folder / file_layout.GAUSSIANS, ranks, rows, objects, None, scene)
    files, paths = Frames(folder, ranks, count), []
    F = np.tile(np.eye(3, dtype="f4").reshape(9), (count, 1))
    for k in range(frames):
        x = (rows["x0"] * (1 - 0.02 * k)).astype("f4")
        fields = {"positions": x, "velocity": x, "J": np.ones(count, "f4"), "F": F,
                  "object": rows["object"]}  # fmt: skip
        paths.append(files.write(k, 0.04 * k, k, np.arange(count), fields))
    return paths


def measure_delays(count: int, frames: int, progress: Callable[[str], None]) -> Delays:
    """Move frames into the folder of a followed run, one by one."""
    with tempfile.TemporaryDirectory() as text:
        folder, seconds = Path(text) / "out", []
        folder.mkdir()
        paths = write_cloud(folder, count, frames + 2)
        for path in paths[1:]:
            path.rename(folder / path.name)
        with live_page(folder, "--particles", str(count)) as address:
            viewer = Viewer(address)
            try:
                viewer.wait_for(ROW_BYTES * count, 0.0)
                for k, path in enumerate(paths[1:]):
                    time.sleep(0.4)
                    begin = time.time()
                    (folder / path.name).rename(path)
                    seconds.append(viewer.wait_for(ROW_BYTES * count, begin) - begin)
                    progress(f"frame {k + 1} of {frames + 1}: {seconds[-1]:.2f} s")
            finally:
                viewer.close()
    return Delays(count, seconds[1:])  # the first one loads code


def measure_slowdown(
    rounds: int, ranks: int, end: float, frames: int, progress: Callable[[str], None]
) -> Slowdown:
    """Run a scene without the page and with it and a viewer, in turns."""
    without: list[float] = []
    having: list[float] = []
    page: list[float] = []
    with tempfile.TemporaryDirectory() as text:
        scene = Path(text) / "scene.toml"
        scene.write_text(SCENE.format(end=end, frames=frames))
        _run(scene, Path(text) / "first", ranks, False)  # compiles
        for k in range(rounds):
            for is_live in (False, True) if k % 2 else (True, False):
                out = Path(text) / f"out-{k}-{is_live}"
                seconds, spent = _run(scene, out, ranks, is_live)
                (having if is_live else without).append(seconds)
                page += [spent] if is_live else []
                name = "with" if is_live else "without"
                progress(f"round {k + 1} of {rounds}, {name} the page: {seconds:.2f} s")
    return Slowdown(without, having, page)


def _run(scene: Path, out: Path, ranks: int, is_live: bool) -> tuple[float, float]:
    """Run a scene; return the seconds of its steps, and the processor time of its page."""
    words = [sys.executable, "-m", "vgmpi", str(scene), "-o", str(out), "--ranks", "1"]
    words += ["--live", "0"] if is_live else []
    command = ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words
    env = os.environ | OPEN_MPI | {"PYTHONPATH": str(ROOT)}
    job = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=env
    )
    viewer, lines, page = None, [], 0
    assert job.stdout is not None
    for line in job.stdout:
        lines.append(line)
        if match := re.search(r"http://localhost:(\d+)/ \(process (\d+)\)", line):
            viewer, page = Viewer(f"ws://127.0.0.1:{match[1]}/"), int(match[2])
    job.wait()
    spent = 0.0
    if viewer is not None:
        fields = Path(f"/proc/{page}/stat").read_text().rpartition(")")[2].split()
        spent = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        viewer.close()
        os.kill(page, signal.SIGTERM)
    match = PACE.search("".join(lines))
    if match is None or (is_live and viewer is None):
        raise RuntimeError("".join(lines))
    return float(match[1]), spent


def text(delays: Delays, slowdown: Slowdown) -> str:
    """What was measured."""
    ratios = sorted(slowdown.ratios)
    return "\n".join([
        f"delay of {delays.gaussians:,} Gaussians from a frame's file to a viewer: median "
        f"{median(delays.seconds):.2f} s, largest {max(delays.seconds):.2f} s of "
        f"{len(delays.seconds)} frames",
        f"a run with the page and a viewer takes {median(ratios):.3f} of its time without "
        f"({ratios[0]:.3f} .. {ratios[-1]:.3f}, {len(ratios)} pairs; median "
        f"{median(slowdown.without):.1f} s without); the page used "
        f"{median(slowdown.page):.1f} s of processor time",
    ])  # fmt: skip
