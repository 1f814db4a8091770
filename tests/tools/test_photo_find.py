"""--find proposes boxes around what stands out, in a layout to go on with."""

import re
import sys

import numpy as np
import pytest
from PIL import Image

from tests.support import drawn_photograph
from tests.support.launch import ROOT, run
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.tools.photo import box_proposals, grabcut
from vgmpi.tools.photo import layout_config as layouts
from vgmpi.tools.photo.__main__ import main

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")


def filled(box):
    found = np.zeros(drawn_photograph.three().rgb.shape[:2], dtype=bool)
    found[box[1] : box[3], box[0] : box[2]] = True
    return found


def test_boxes_are_around_the_things_and_the_layout_goes_on(tmp_path):
    photo, _ = drawn_photograph.put(tmp_path)
    out = tmp_path / "out"
    assert main([str(photo), "--find", "-o", str(out)]) == 0
    told = layouts.read(out / "layout.toml")
    assert np.asarray(Image.open(out / "find.png")).shape == (480, 640, 3)
    names, true = {}, drawn_photograph.three().masks
    for name, mask in zip(drawn_photograph.NAMES, true):
        scores = {
            thing.name: grabcut.iou(filled(grabcut.box_of(mask)), filled(thing.box))
            for thing in told.layout.object
        }
        best = max(scores, key=scores.get)
        print(name, scores[best])
        assert scores[best] >= 0.75
        names[best] = name
    assert len(names) == len(told.layout.object) == 3
    text = (out / "layout.toml").read_text()
    for proposal, name in names.items():
        text = text.replace(proposal, name)
    text = re.sub(r'(name = "cup"\n.*\n)# (height.*\n)', r"\1\2", text)
    (out / "layout.toml").write_text(text)
    assert main([str(photo), str(out / "layout.toml"), "-o", str(out)]) == 0
    for name, mask in zip(drawn_photograph.NAMES, true):
        found = np.asarray(Image.open(out / "masks" / f"{name}.png")) > 0
        assert grabcut.iou(found, mask) >= 0.95


def test_settings_of_a_layout_without_objects_are_kept(tmp_path):
    photo, layout = drawn_photograph.put(tmp_path, "# mine\n[camera]\nfov = 38  # measured\n")
    assert main([str(photo), str(layout), "--find", "-o", str(tmp_path / "out")]) == 0
    assert layout.read_text().startswith("# mine\n[camera]\nfov = 38  # measured\n")
    told = layouts.read(layout).layout
    assert told.camera.fov == 38 and len(told.object) == 3


def test_objects_that_are_there_are_not_overwritten(tmp_path, capsys):
    photo, layout = drawn_photograph.put(tmp_path)
    text = layout.read_text()
    assert main([str(photo), str(layout), "--find", "-o", str(tmp_path / "out")]) == 2
    assert "there are objects already" in capsys.readouterr().err
    assert layout.read_text() == text and not (tmp_path / "out").exists()


def test_a_picture_of_nothing_has_no_proposals(tmp_path, capsys):
    path = tmp_path / "grey.png"
    Image.fromarray(np.full((200, 300, 3), 120, np.uint8)).save(path)
    assert main([str(path), "--find", "-o", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{path}: nothing in it stands out")
    assert not (tmp_path / "out").exists()


def test_boxes_that_are_one_are_proposed_once():
    one, same, other = (
        grabcut.Box(0, 0, 50, 50),
        grabcut.Box(5, 5, 45, 45),
        grabcut.Box(45, 0, 90, 50),
    )
    assert box_proposals.suppress_overlaps([one, same, other]) == [one, other]


def test_the_example_is_made_and_its_scene_is_right(tmp_path):
    """runs/photo, as its README has it, up to the run."""
    script = ROOT / "runs" / "photo" / "make_photo.py"
    assert run([sys.executable, script, tmp_path]).returncode == 0
    photo, layout = tmp_path / "photo.png", tmp_path / "layout.toml"
    assert main([str(photo), str(layout), "-o", str(tmp_path)]) == 0
    made = build_scene(load(tmp_path / "scene.toml"))
    assert len(made.x) > 100_000
    told = {thing.name: thing for thing in layouts.read(layout).layout.object}
    assert told["orange"].material == "fruit" and told["jelly"].material == "jelly"
    eye = drawn_photograph.eye_of(tmp_path)
    truth = drawn_photograph.drawing.TABLE[0]
    found = drawn_photograph.corners(tmp_path, "orange").mean(axis=0)
    view_eye = drawn_photograph.drawing.PHOTO[1]
    off = found - (np.array(truth.middle) - (0, 0, view_eye))
    print("the orange is off by", off.round(4), "m; the eye by", round(eye[2] - view_eye, 4))
    # seen at a small angle, distances are told badly: 1 % of the eye's height are 3 % of its
    assert np.abs(off[[0, 2]]).max() < 0.01 and abs(off[1]) < 0.1 * found[1]
    assert abs(eye[2] / view_eye - 1) < 0.03


def test_threads_are_no_part_of_a_mask():
    """As an edge of a table behind a cup makes them, where it has its color."""
    y, x = np.mgrid[:120, :160]
    disc = (x - 80) ** 2 + (y - 60) ** 2 < 40**2
    found = grabcut.remove_threads(disc | (y == 22), grabcut.Box(35, 15, 125, 105))
    assert grabcut.iou(found, disc) > 0.99 and not found[22, :60].any()
    thin = np.zeros((120, 160), bool)
    thin[60, 40:120] = True  # nothing but a thread: it stays
    assert (grabcut.remove_threads(thin, grabcut.Box(40, 20, 120, 100)) == thin).all()


def test_points_say_what_is_it_and_what_is_not():
    """Two discs that touch, of nearly one color: a point parts them, another brings one back."""
    y, x = np.mgrid[:160, :240] + 0.5
    left, right = ((x - c) ** 2 + (y - 80) ** 2 < 36**2 for c in (92, 146))
    rgb = np.full((160, 240, 3), (110, 120, 130), np.uint8)
    rgb[left], rgb[right] = (200, 60, 40), (60, 160, 60)
    noise = np.random.default_rng(1).integers(-5, 6, rgb.shape)
    rgb = np.clip(rgb.astype(int) + noise, 0, 255).astype(np.uint8)
    box = grabcut.Box(40, 36, 200, 124)
    both = grabcut.segment_box(rgb, box, [])
    assert grabcut.iou(both, left | right) > 0.95
    one = grabcut.segment_box(rgb, box, [(160.0, 80.0, False), (80.0, 80.0, True)])
    assert grabcut.iou(one, left & ~right) > 0.95
