"""Videos whose command is stopped or killed: what is left, who still lives, and how it goes on."""

import logging
import os
import re
import signal
import sys
import time
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from tests.support.launch import finish, start, until
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import frame_progress, frame_renderer, image_io

FRAMES = 24
SMALL = drawn_runs.on_paper("[picture]\nwidth = 64\nheight = 48\n")
SLOW = drawn_runs.on_paper("[picture]\nwidth = 640\nheight = 480\nsupersample = 4\n")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=FRAMES)


def begin(out, folder, *flags):
    """Start to draw a video with two processes, and wait for its second picture."""
    (folder / "render.toml").write_text(SLOW)
    files = [out, folder / "render.toml", "-o", folder / "v.mp4", "--frames", folder / "p"]
    words = [sys.executable, "-m", "vgmpi", "render", *files, "--jobs", 2, *flags]
    process = start([str(word) for word in words])
    second = folder / "p" / "frame_00001.png"
    until(lambda: second.exists() or process.poll() is not None, "the second picture")
    assert process.poll() is None, process.communicate()
    return process, children_of(process.pid)


def children_of(pid):
    """Numbers of the processes that a process has started."""
    return [int(n) for n in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(numbers):
    """Those of the processes that still run; ended ones may wait for their parent."""
    running = []
    for number in numbers:
        try:
            state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        if state not in "ZX":
            running.append(number)
    return running


def wait_for_end(numbers):
    """Wait up to two seconds until none of the processes runs; return those that do."""
    end = time.monotonic() + 2.0
    while alive(numbers) and time.monotonic() < end:
        time.sleep(0.02)
    return alive(numbers)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_command(out, tmp_path, number):
    process, children = begin(out, tmp_path)
    assert len(children) >= 3  # two that draw, and ffmpeg
    os.kill(process.pid, number)
    done = finish(process)
    assert wait_for_end(children) == []
    assert not (tmp_path / "v.mp4").exists()
    pictures = sorted((tmp_path / "p").iterdir())
    assert 2 <= len(pictures) < FRAMES
    for path in pictures:  # they are whole
        assert path.suffix == ".png" and iio.imread(path).shape == (480, 640, 3)
    if number == signal.SIGTERM:
        assert done.returncode == 75
        assert "Traceback" not in done.stderr
        assert done.stderr.splitlines()[-1].startswith("stopped: the pictures that are drawn are")
        assert sorted(p.name for p in tmp_path.iterdir()) == ["p", "render.toml"]


def test_a_process_that_is_ended_from_outside_is_one_line(out, tmp_path):
    """As by a system that is out of memory: the command must not wait for it."""
    process, children = begin(out, tmp_path, "-q")
    commands = {n: Path(f"/proc/{n}/cmdline").read_text() for n in children}
    worker = next(n for n in children if "spawn_main" in commands[n])
    os.kill(worker, signal.SIGKILL)
    done = finish(process)
    assert done.returncode == 2
    assert (
        done.stderr == "a process that draws frames was ended: out of memory? --jobs 1 needs less\n"
    )
    assert not (tmp_path / "v.mp4").exists() and wait_for_end(children) == []


def draw(out, folder, *flags, text=SMALL):
    (folder / "render.toml").write_text(text)
    return render.main([str(out), str(folder / "render.toml"), "--jobs", "1", *map(str, flags)])


@pytest.fixture
def drawn(monkeypatch):
    """Frames that are drawn, in order."""
    numbers, views_of = [], frame_renderer.FrameRenderer.views_of
    monkeypatch.setattr(
        frame_renderer.FrameRenderer,
        "views_of",
        lambda self, index, part: numbers.append(index) or views_of(self, index, part),
    )
    return numbers


def test_a_video_goes_on_from_its_pictures(out, tmp_path, drawn):
    flags = ("-q", "-o", tmp_path / "v.mp4", "--frames", tmp_path / "p")
    assert draw(out, tmp_path, *flags) == 0
    whole = (tmp_path / "v.mp4").read_bytes()
    assert drawn == list(range(FRAMES))
    for missing in (3, 20, 23):
        (tmp_path / "p" / f"frame_{missing:05d}.png").unlink()
    (tmp_path / "v.mp4").unlink()
    drawn.clear()
    assert draw(out, tmp_path, *flags, "--resume") == 0
    assert drawn == [3, 20, 23]
    assert (tmp_path / "v.mp4").read_bytes() == whole
    drawn.clear()
    assert draw(out, tmp_path, *flags) == 0  # without the flag all are drawn
    assert len(drawn) == FRAMES


def test_pictures_that_are_not_valid_any_more_are_drawn_again(out, tmp_path, drawn):
    folder = ("-q", "-o", tmp_path / "p", "--depth", tmp_path / "d")
    assert draw(out, tmp_path, *folder) == 0
    first = {p.name: p.read_bytes() for p in (tmp_path / "p").iterdir()}
    drawn.clear()
    assert draw(out, tmp_path, *folder, "--resume") == 0 and drawn == []
    newer = out / "frames" / "frame_00004.vtkhdf"
    before = newer.stat()
    os.utime(newer)  # a frame of a later run
    (tmp_path / "d" / "frame_00007.npy").unlink()  # stopped between two files
    (tmp_path / "p" / "frame_00009.png").write_bytes(b"broken")
    assert draw(out, tmp_path, *folder, "--resume") == 0 and drawn == [4, 7, 9]
    os.utime(newer, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert {p.name: p.read_bytes() for p in (tmp_path / "p").iterdir()} == first
    drawn.clear()
    other = SMALL.replace("[picture]", '[picture]\nbackground = "#102030"')
    assert draw(out, tmp_path, *folder, "--resume", text=other) == 0
    assert len(drawn) == FRAMES


def test_a_video_without_pictures_cannot_go_on(out, tmp_path, capsys):
    assert draw(out, tmp_path, "-q", "-o", tmp_path / "v.mp4", "--resume") == 2
    said = capsys.readouterr().err
    assert said == "--resume: allowed: with --frames DIR, or -o and a folder\n"


def test_lines_tell_the_frame_the_pace_and_the_time_left(out, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(frame_progress, "EVERY", 0.02)
    add = image_io.Film.add
    monkeypatch.setattr(image_io.Film, "add", lambda *a: time.sleep(0.03) or add(*a))
    caplog.set_level(logging.INFO, "vgmpi")
    assert draw(out, tmp_path, "-o", tmp_path / "v.mp4") == 0
    lines = [m for m in caplog.messages if m.startswith("frame ")]
    pattern = rf"frame (\d+) of {FRAMES}, \d+\.\d\d s per frame, \d+ s left"
    counts = [int(match[1]) for line in lines if (match := re.fullmatch(pattern, line))]
    assert len(counts) > 5 and counts == sorted(counts) and counts[-1] <= FRAMES
    assert np.unique(counts).size > 5


def test_no_lines_if_quiet(out, tmp_path, monkeypatch, capsys, caplog):
    monkeypatch.setattr(frame_progress, "EVERY", 0.001)
    assert draw(out, tmp_path, "-q", "-o", tmp_path / "v.mp4") == 0
    assert not caplog.messages and capsys.readouterr().err == ""


BUSY = """
import multiprocessing, time
from vgmpi.postprocess.frames.frame_processes import end_with_parent

def work():
    end_with_parent()
    print("busy", flush=True)
    while True:
        pass

if __name__ == "__main__":
    multiprocessing.get_context("spawn").Process(target=work, daemon=True).start()
    time.sleep(1000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_process_in_the_middle_of_a_frame_ends_with_the_command(tmp_path):
    """It reads no pipe then, which would tell it."""
    (tmp_path / "busy.py").write_text(BUSY)
    process = start([sys.executable, str(tmp_path / "busy.py")])
    assert process.stdout.readline() == "busy\n"
    children = children_of(process.pid)
    os.kill(process.pid, signal.SIGKILL)
    assert wait_for_end(children) == []
    finish(process)
