"""Pictures and videos on a full disk or a read-only file system: one line, and one exit code."""

import errno
import os
import sys
from pathlib import Path

import imageio_ffmpeg
import pytest

from tests.support import drawn_runs
from tests.support.launch import run
from vgmpi.postprocess.commands import render, view
from vgmpi.runtime import user_files
from vgmpi.tools.fit import __main__ as fit

SMALL = drawn_runs.on_paper("[picture]\nwidth = 64\nheight = 48\n")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=2)


@pytest.fixture
def full_disk(monkeypatch):
    """Files cannot be flushed, and ffmpeg says what it says on a full disk."""

    def fail(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(user_files.os, "fsync", fail)


def program(path, text):
    """Write a program that says a line and fails."""
    path.write_text(f"#!/bin/sh\necho '{text}' >&2\nexit 1\n")
    path.chmod(0o755)
    return str(path)


def draw(out, folder, name, *flags):
    (folder / "render.toml").write_text(SMALL)
    words = [out, folder / "render.toml", "-q", "-o", folder / name, "--jobs", 1, *flags]
    return render.main([str(word) for word in words])


@pytest.mark.parametrize("name", ["a.png", "folder"])
def test_a_picture_on_a_full_disk(out, tmp_path, full_disk, capsys, name):
    (tmp_path / "a.png").write_bytes(b"before")
    assert draw(out, tmp_path, name) == 1
    said = capsys.readouterr().err
    assert said.endswith(": No space left on device\n") and said.count("\n") == 1
    assert (tmp_path / "a.png").read_bytes() == b"before"
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_video_on_a_full_disk(out, tmp_path, monkeypatch, capsys):
    ffmpeg = program(
        tmp_path / "ffmpeg", "[out#0/mp4 @ 0x1] Error writing: No space left on device"
    )
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: ffmpeg)
    assert draw(out, tmp_path, "v.mp4") == 1
    said = capsys.readouterr().err
    assert said.endswith("v.mp4: Error writing: No space left on device\n")
    assert said.count("\n") == 1


def test_a_view_on_a_full_disk_keeps_the_picture_that_was_there(out, tmp_path, full_disk, capsys):
    pytest.importorskip("pyvista")
    path = tmp_path / "a.png"
    path.write_bytes(b"before")
    assert view.main([str(out), "--frame", "1", "-o", str(path), "--color", "J"]) == 1
    assert capsys.readouterr().err == f"{path}: No space left on device\n"
    assert path.read_bytes() == b"before" and list(tmp_path.iterdir()) == [path]


def test_a_video_on_a_read_only_file_system(out, tmp_path, monkeypatch, capsys):
    """There even the removal of a file that does not exist is an error."""

    def refuse(path, missing_ok=False):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    ffmpeg = program(tmp_path / "ffmpeg", "file:.v.part.mp4: Read-only file system")
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: ffmpeg)
    monkeypatch.setattr(Path, "unlink", refuse)
    assert draw(out, tmp_path, "v.mp4") == 2
    said = capsys.readouterr().err
    assert "Read-only file system" in said and said.count("\n") == 1


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc, where nobody can write")
@pytest.mark.parametrize("command, name", [("render", "v.mp4"), ("view", "a.png")])
def test_a_place_where_nobody_can_write(out, command, name):
    if command == "view":
        pytest.importorskip("pyvista")
    color = ["--color", "J"] if command == "view" else []
    done = run([sys.executable, "-m", "vgmpi", command, out, *color, "-o", f"/proc/{name}"])
    assert done.returncode == 2
    errors = [line for line in done.stderr.splitlines() if "No such file" in line]
    assert len(errors) == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("number, code", [(errno.EROFS, 2), (errno.ENOSPC, 1)])
def test_a_fit_whose_folder_cannot_be_written(tmp_path, monkeypatch, capsys, number, code):
    def refuse(*arguments):
        raise OSError(number, os.strerror(number), str(tmp_path / "fit"))

    monkeypatch.setattr(fit, "load", refuse)
    assert fit.main(["scene.toml", "fit.toml", "-o", str(tmp_path / "fit")]) == code
    assert capsys.readouterr().err == f"{tmp_path / 'fit'}: {os.strerror(number)}\n"
