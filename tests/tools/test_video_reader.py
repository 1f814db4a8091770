"""Pictures of target videos: each is read once, whatever the format and the rate."""

import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from vgmpi.postprocess.frames.image_io import Film, write_png
from vgmpi.tools.fit.video_reader import describe_pictures, pictures_in

LEVELS = 12  # difference of one picture from the next


def write_video(path, count, fps):
    """Write gray pictures, each LEVELS brighter than the one before."""
    with Film(path, 32, 32, fps) as film:
        for k in range(count):
            film.add(np.full((32, 32, 3), LEVELS * (k + 1), np.uint8))


@pytest.mark.parametrize("fps", [5, 16, 25, 50, 100])
@pytest.mark.parametrize("count", [1, 3, 20])
@pytest.mark.parametrize("suffix", [".gif", ".mp4", ".webm"])
def test_each_picture_is_read_once(tmp_path, suffix, count, fps):
    path = tmp_path / f"v{suffix}"
    write_video(path, count, fps)
    found = [int(picture[16, 16, 0]) for picture in pictures_in(path)]
    np.testing.assert_allclose(found, LEVELS * np.arange(1, count + 1), atol=2)


def test_pictures_with_times_of_their_own(tmp_path):
    """Pillow writes them; a picture that is shown for 0.4 s is one picture."""
    pictures = [Image.fromarray(np.full((32, 32), 60 * k, np.uint8)) for k in range(1, 5)]
    durations = [40, 400, 40, 90]  # [ms]
    path = tmp_path / "v.gif"
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations)
    found = [int(picture[16, 16, 0]) for picture in pictures_in(path)]
    np.testing.assert_allclose(found, [60, 120, 180, 240], atol=2)
    assert describe_pictures(path, 4) == "4 pictures, 0.04 to 0.4 s apart, over 0.48 s"


@pytest.mark.parametrize(
    "name, fps, text",
    [
        ("v.mp4", 25, "3 pictures, 0.04 s apart, over 0.08 s"),
        ("v.webm", 50, "3 pictures, 0.02 s apart, over 0.04 s"),
        ("v.gif", 16, "3 pictures, 0.06 to 0.07 s apart, over 0.13 s"),  # of 0.01 s each
    ],
)
def test_count_and_times_are_told(tmp_path, name, fps, text):
    write_video(tmp_path / name, 3, fps)
    assert describe_pictures(tmp_path / name, 3) == text
    assert describe_pictures(tmp_path / name, 2) == "2 pictures"  # not those of the time stamps


def test_a_stream_without_time_stamps_has_a_count(tmp_path):
    """A bare H.264 stream, as some cameras write it."""
    write_video(tmp_path / "v.mp4", 3, 25)
    copy = ["-c:v", "copy", "-f", "h264", tmp_path / "v.h264"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", tmp_path / "v.mp4", *copy]
    subprocess.run(command, check=True)
    assert len(list(pictures_in(tmp_path / "v.h264"))) == 3
    assert describe_pictures(tmp_path / "v.h264", 3) == "3 pictures"


def test_a_folder_has_no_times(tmp_path):
    for k in range(3):
        write_png(tmp_path / f"{k}.png", np.zeros((8, 8, 3), np.uint8))
    assert describe_pictures(tmp_path, 3) == "3 pictures"
