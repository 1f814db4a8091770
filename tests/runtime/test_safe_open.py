"""What a user names is a regular file of bounded cost, wherever it is opened."""

import os
import struct
import sys
import zlib

import numpy as np
import pytest

from tests.support import launch
from vgmpi.commands import cli
from vgmpi.io.run_reader import RunError, RunReader, inspect, read_gaussians
from vgmpi.postprocess.frames import camera_paths, image_io
from vgmpi.postprocess.frames.render_config import SettingsError
from vgmpi.preprocess.meshes import triangle_mesh
from vgmpi.runtime import process_limits, user_files


def large(path, width=10_000, height=10_000):
    """The head of a picture of that size, and nothing behind it: 2.4 GB once it is read."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + body)


@pytest.fixture(params=["pipe", "/dev/zero", "folder"])
def odd(request, tmp_path):
    path = tmp_path / "odd"
    if request.param == "pipe":
        os.mkfifo(path)
    elif request.param == "folder":
        path.mkdir()
    else:
        os.symlink(request.param, path)
    return path


def test_a_scene_is_a_file(odd, capsys):
    assert cli.main([str(odd), "--check"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{odd}: is no regular file")


@pytest.mark.parametrize("suffix", ["", ".ply", ".obj", ".spz", ".h5"])
def test_what_is_inspected_is_a_file(tmp_path, suffix, capsys):
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    assert cli.main(["--inspect", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line and "no regular file" in line


def test_settings_cameras_and_backgrounds_are_files(odd):
    with pytest.raises(SettingsError, match="is no regular file"):
        camera_paths.read_transforms(odd)
    with pytest.raises(image_io.VideoError, match="is no regular file"):
        image_io.background(str(odd), 8, 8, odd.parent)
    with pytest.raises(triangle_mesh.TextureError, match="is no regular file"):
        triangle_mesh.read_texture(odd)
    with pytest.raises(RunError, match="no regular file|is a link"):
        read_gaussians(odd)


def test_settings_of_a_renderer_are_a_file(odd):
    command = [sys.executable, "-m", "vgmpi", "render", odd.parent, odd]
    done = launch.run(command)
    kind = "is a folder" if odd.is_dir() else "is no regular file"
    assert done.returncode == 2 and kind in done.stderr, done.stderr


def test_a_scene_is_not_large(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    with open(path, "wb") as f:
        f.truncate(user_files.MAX_TEXT_BYTES + 1)
    assert cli.main([str(path), "--check"]) == 2
    assert "has 16,777,217 bytes; at most 16,777,216 are read" in capsys.readouterr().err


def test_pictures_are_not_large(tmp_path):
    """Their head says so, before a pixel is read."""
    path = tmp_path / "a.png"
    large(path)
    for read in (triangle_mesh.read_texture, lambda p: image_io.background(p.name, 8, 8, tmp_path)):
        with pytest.raises(
            (triangle_mesh.TextureError, image_io.VideoError), match="has 10,000 x 10,000 pixels"
        ):
            read(path)


def test_pictures_fit_into_the_memory(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    large(path, 5000, 5000)
    monkeypatch.setattr(process_limits, "available_memory", lambda swap=False: 500 << 20)
    key = f"picture.background: {path}: "  # where it stands in render.toml
    with pytest.raises(triangle_mesh.TextureError, match="its 5,000 x 5,000 pixels take at least"):
        triangle_mesh.read_texture(path)
    with pytest.raises(image_io.VideoError, match=f"^{key}its 5,000 x 5,000 pixels take at least"):
        image_io.background(path.name, 8, 8, tmp_path)


def test_others_are_as_they_were(tmp_path):
    import imageio.v3 as iio

    pixels = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    iio.imwrite(tmp_path / "a.png", pixels)
    assert (user_files.read_image(tmp_path / "a.png") == pixels).all()
    assert (
        user_files.read_regular_file(tmp_path / "a.png", 10**6) == (tmp_path / "a.png").read_bytes()
    )


def test_a_file_that_is_not_there_is_named_as_it_may_be_meant(tmp_path, capsys):
    (tmp_path / "Bridge.toml").touch()
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "sky.png").touch()
    assert cli.main([str(tmp_path / "brigde.toml"), "--check"]) == 2
    said = f"{tmp_path}/brigde.toml: No such file or directory (did you mean 'Bridge.toml'?)\n"
    assert capsys.readouterr().err == said
    with pytest.raises(image_io.VideoError, match=r"no such file \(did you mean 'sky.png'\?\)"):
        image_io.background("pictures/skyy.png", 8, 8, tmp_path)
    with pytest.raises(image_io.VideoError, match=r"no such file \(did you mean 'pictures'\?\)"):
        image_io.background("picture/sky.png", 8, 8, tmp_path)
    with pytest.raises(RunError, match=r"no such folder \(did you mean 'pictures'\?\)"):
        RunReader(tmp_path / "picture")
    with pytest.raises(RunError, match=r"no such file \(did you mean 'sky.png'\?\)"):
        inspect(tmp_path / "pictures" / "sky.h5")
    with pytest.raises(SettingsError, match="No such file or directory$"):
        camera_paths.read_transforms(tmp_path / "a.json")
