"""vgmpi photo --demo: its examples; what is wrong with the flags is one line.

Each makes a scene that runs in tests/tools/test_written_scenes.py.
"""

import sys

import numpy as np
import pytest
from PIL import Image

from tests.support.launch import ROOT, run
from vgmpi.tools.photo import example_photographs
from vgmpi.tools.photo.__main__ import main

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
pytest.importorskip("tomlkit", reason="no tomlkit: pip install 'vgmpi[images]'")


def test_a_second_start_goes_on_with_the_layout_that_lies_there(tmp_path):
    pytest.importorskip("skimage", reason="scikit-image has the photograph")
    example_photographs.write_example("rocket", tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(layout.read_text() + "# mine\n")
    text = layout.read_text()
    assert example_photographs.write_example("rocket", tmp_path) == (tmp_path / "photo.png", layout)
    assert layout.read_text() == text


def test_the_examples_are_listed(capfd):
    assert main(["--demo"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == list(example_photographs.SUMMARIES)
    folders = {path.name for path in example_photographs.FOLDER.iterdir()}
    assert folders == set(example_photographs.SUMMARIES)


def test_the_drawn_photographs_are_those_of_the_script(tmp_path):
    script = ROOT / "runs" / "photo" / "make_photo.py"
    assert run([sys.executable, script, "--examples", tmp_path]).returncode == 0
    for name in ("milk", "tower", "balls"):
        old, new = (
            np.asarray(Image.open(path), dtype=float)
            for path in (example_photographs.FOLDER / name / "photo.jpg", tmp_path / f"{name}.jpg")
        )
        assert np.abs(old - new).mean() < 0.5


@pytest.mark.parametrize(
    "words, says",
    [
        (["--demo", "cofee", "-o", "OUT"], "--demo: no such example (did you mean 'coffee'?)"),
        (["--demo", "milk"], "-o: an output folder is needed"),
        (["photo.jpg", "--demo", "milk", "-o", "OUT"], "--demo: not allowed with a photograph"),
        (["--demo", "milk", "--find", "-o", "OUT"], "--demo: not allowed with --find"),
        (["-o", "OUT"], "no photograph is given"),
        (["photo.jpg", "--find", "--video", "-o", "OUT"], "--video: not allowed with --find"),
    ],
)
def test_wrong_flags_are_one_line(tmp_path, words, says, capfd):
    words = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    assert main(words) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text and not (tmp_path / "out").exists()


def test_a_missing_scikit_image_is_one_line(tmp_path, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    assert main(["--demo", "coffee", "-o", str(tmp_path / "out")]) == 2
    text = capfd.readouterr().err.strip()
    assert text.endswith("not installed: pip install 'vgmpi[demo]'") and "\n" not in text
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_one_command_makes_a_video(tmp_path):
    words = [sys.executable, "-m", "vgmpi", "photo", "--demo", "balls", "-o", tmp_path, "--video"]
    ended = run(words)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "out" / "video.mp4").stat().st_size > 10_000
