"""Pictures and videos on disk."""

import io
import subprocess
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest

from tests.support.headless_browser import FLAGS, browser_of, new_page
from vgmpi.postprocess.frames import image_io
from vgmpi.tools.fit.video_reader import pictures_in

COLORS = np.array([*np.eye(3) * 255, (224, 112, 48), (90, 90, 90), (0,) * 3, (255,) * 3], int)
FORMATS = ((".mp4", False), (".webm", False), (".webm", True), (".gif", False))
SIZES = ((640, 360), (800, 800), (1920, 1080))


def gradient(width, height):
    picture = np.zeros((height, width, 3), dtype=np.uint8)
    picture[..., 0] = np.linspace(0, 255, width)
    picture[..., 2] = np.linspace(255, 0, height)[:, None]
    return picture


def read(path):
    frames = imageio_ffmpeg.read_frames(str(path))
    meta = next(frames)
    width, height = meta["source_size"]
    return meta, [np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in frames]


def stripes(width, height):
    """A picture of upright stripes with COLORS."""
    column = np.arange(width) * len(COLORS) // width
    return np.tile(COLORS[column].astype(np.uint8), (height, 1, 1))


def colors_of_stripes(picture):
    """Colors in the middle of each stripe."""
    height, width = picture.shape[:2]
    columns = ((np.arange(len(COLORS)) + 0.5) * width / len(COLORS)).astype(int)
    return picture[height // 2, columns, :3].astype(int)


def film_of_stripes(path, width, height, clear):
    """Write a video of three pictures."""
    picture = stripes(width, height)
    if clear:
        picture = np.dstack([picture, np.full((height, width), 255, np.uint8)])
    with image_io.Film(path, width, height, fps=5, clear=clear) as film:
        for _ in range(3):
            film.add(picture)


@pytest.mark.parametrize("width, height", SIZES)
@pytest.mark.parametrize("suffix, clear", FORMATS)
def test_colors_are_kept_and_tagged(tmp_path, suffix, clear, width, height):
    """ffmpeg decodes the colors, and finds the tags that tell players how to."""
    path = tmp_path / f"v{suffix}"
    film_of_stripes(path, width, height, clear)
    pictures = list(pictures_in(path))
    assert len(pictures) == 3
    for picture in pictures:
        assert np.abs(colors_of_stripes(picture) - COLORS).max() <= 2
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-i", path]
    about = subprocess.run(command, capture_output=True, text=True).stderr
    # matrix, primaries, transfer
    assert suffix == ".gif" or "(tv, smpte170m/bt709/iec61966-2-1" in about


@pytest.mark.browser
@pytest.mark.parametrize(
    "flags", [["--no-sandbox", "--disable-gpu"], FLAGS], ids=["plain", "WebGL"]
)
def test_a_browser_shows_the_colors(tmp_path, flags):
    """On both ways by which Chromium composes a page: they differ for videos without tags."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    errors = {}
    with api.sync_playwright() as play:
        browser = browser_of(play, flags)
        for width, height in SIZES:
            page = new_page(browser, width, height)
            for suffix, clear in FORMATS:
                name = f"{width}x{height}{'-clear' if clear else ''}{suffix}"
                film_of_stripes(tmp_path / name, width, height, clear)
                html = f'<body style="margin: 0"><video id="v" muted src="{name}"></video>'
                ready = "document.getElementById('v').readyState >= 2"
                if suffix == ".gif":
                    html = html.replace("video", "img").replace("</img>", "")
                    ready = "document.getElementById('v').complete"
                (tmp_path / "page.html").write_text(html)
                page.goto((tmp_path / "page.html").as_uri())
                page.wait_for_function(ready)
                page.wait_for_timeout(300)
                shown = iio.imread(io.BytesIO(page.screenshot()))
                errors[name] = int(np.abs(colors_of_stripes(shown) - COLORS).max())
            page.close()
        browser.close()
    assert max(errors.values()) <= 2, errors


@pytest.mark.parametrize("width, height", [(64, 48), (65, 47)])
def test_a_video_holds_the_pictures_in_order(tmp_path, width, height):
    path = tmp_path / "deeper" / "v.mp4"
    pictures = [np.full((height, width, 3), 40 * k, np.uint8) for k in range(5)]
    pictures[2] = gradient(width, height)
    with image_io.Film(path, width, height, fps=10) as mp4:
        for picture in pictures:
            mp4.add(picture)
    meta, got = read(path)
    assert meta["codec"] == "h264" and meta["fps"] == 10 and "yuv420p" in meta["pix_fmt"]
    assert len(got) == 5
    assert got[0].shape == (height + height % 2, width + width % 2, 3)
    for picture, back in zip(pictures, got):
        back = back[:height, :width].astype(int)
        assert np.abs(back - picture).mean() < 6
    assert [p.name for p in path.parent.iterdir()] == ["v.mp4"]


def test_a_video_that_fails_leaves_nothing_and_keeps_the_old_one(tmp_path):
    path = tmp_path / "v.mp4"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        with image_io.Film(path, 64, 48, fps=10) as mp4:
            mp4.add(gradient(64, 48))
            raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["v.mp4"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(image_io.VideoError) as caught:
        with image_io.Film(tmp_path / "file" / "v.mp4", 64, 48, fps=10) as mp4:
            mp4.add(gradient(64, 48))
    assert "\n" not in str(caught.value) and "v.mp4" in str(caught.value)
    with pytest.raises(image_io.VideoError, match="a.png"):
        image_io.write_png(tmp_path / "file" / "a.png", gradient(4, 4))


@pytest.mark.parametrize("bad", ["-crf", "-c:v"])
def test_a_video_that_ffmpeg_gives_up_is_one_line_and_no_file(tmp_path, bad):
    """As when the disk is full: what counts is that it ends with an error."""
    writer = image_io.Film(tmp_path / "v.mp4", 64, 48, fps=10)
    writer.command[writer.command.index(bad) + 1] = "nonsense"
    with pytest.raises(image_io.VideoError) as caught:
        with writer as mp4:
            for _ in range(2000):  # more than the pipe holds
                mp4.add(gradient(64, 48))
    assert "v.mp4: " in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_video_that_ends_badly_after_the_last_picture(tmp_path):
    writer = image_io.Film(tmp_path / "v.mp4", 64, 48, fps=10)
    writer.command[0] = "false"
    with pytest.raises(image_io.VideoError):
        with writer:
            pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["http://127.0.0.1:1/v.mp4", "-y.mp4", "concat:a|b.mp4", "%d.mp4"])
def test_a_name_is_a_file_whatever_ffmpeg_would_make_of_it(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with image_io.Film(name, 16, 16, fps=10) as mp4:
        mp4.add(np.zeros((16, 16, 3), np.uint8))
    assert Path(name).read_bytes()[4:8] == b"ftyp"
    assert len([p for p in tmp_path.rglob("*") if p.is_file()]) == 1


def test_a_folder_is_not_replaced_by_a_video(tmp_path):
    (tmp_path / "v.mp4").mkdir()
    with pytest.raises(image_io.VideoError, match="v.mp4: is a folder"):
        with image_io.Film(tmp_path / "v.mp4", 16, 16, fps=10) as mp4:
            mp4.add(np.zeros((16, 16, 3), np.uint8))


def test_png_files_are_exact(tmp_path):
    image_io.write_png(tmp_path / "new" / "a.png", gradient(31, 17))
    np.testing.assert_array_equal(iio.imread(tmp_path / "new" / "a.png"), gradient(31, 17))


def test_bytes_are_rounded_and_cut():
    got = image_io.to_bytes(np.array([-0.1, 0, 0.4999 / 255, 0.5001 / 255, 1, 1.7]))
    np.testing.assert_array_equal(got, [0, 0, 0, 1, 255, 255])


def test_backgrounds_of_one_color(tmp_path):
    np.testing.assert_allclose(
        image_io.background("#ff8000", 4, 4, tmp_path), [1, 128 / 255, 0], atol=1e-12
    )
    np.testing.assert_array_equal(
        image_io.background((0.1, 0.2, 0.3), 4, 4, tmp_path), [0.1, 0.2, 0.3]
    )


@pytest.mark.parametrize("size", [(40, 30), (20, 30), (90, 10), (7, 5)])
def test_a_picture_is_cut_in_the_middle_and_scaled(tmp_path, size):
    width, height = size
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[25:35, 35:45] = 255  # a mark in the middle
    iio.imwrite(tmp_path / "b.png", picture)
    got = image_io.background("b.png", width, height, tmp_path)
    assert got.shape == (height, width, 3)
    y, x = np.nonzero(got[..., 0] > 0.5)
    assert y.mean() == pytest.approx((height - 1) / 2, abs=0.6)
    assert x.mean() == pytest.approx((width - 1) / 2, abs=0.6)


def test_grey_and_transparent_pictures(tmp_path):
    iio.imwrite(tmp_path / "grey.png", np.full((8, 8), 51, np.uint8))
    np.testing.assert_allclose(image_io.background("grey.png", 4, 4, tmp_path), 0.2)
    iio.imwrite(tmp_path / "clear.png", np.full((8, 8, 4), 102, np.uint8))
    np.testing.assert_allclose(image_io.background("clear.png", 4, 4, tmp_path), 0.4)


def test_pictures_that_are_none(tmp_path):
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    for name in ("bad.png", "none.png"):
        with pytest.raises(image_io.VideoError) as caught:
            image_io.background(name, 4, 4, tmp_path)
        assert name in str(caught.value) and "\n" not in str(caught.value)
