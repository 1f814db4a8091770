"""Points decide a mask: what lies on the object stays in, what lies outside stays out. A point that
the mask contradicts is told by its line, and so is a mask that is hardly right.
"""

import numpy as np
import pytest
from PIL import Image

from vgmpi.tools.photo import grabcut, layout_config, object_masks, photograph

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
BOX = grabcut.Box(40, 40, 260, 160)


def two_plates() -> np.ndarray:
    """A photograph of two red plates of one object on a gray table, the left one larger."""
    y, x = np.mgrid[0:200, 0:300]
    noise = np.random.default_rng(3).integers(-6, 7, (200, 300, 3))
    rgb = np.full((200, 300, 3), 150) + noise
    plates = (np.hypot(x - 100, y - 100) < 45) | (np.hypot(x - 215, y - 100) < 32)
    rgb[plates] = (200, 40, 30) + noise[plates]
    return np.clip(rgb, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("points", [[], [(215.0, 100.0, True)], [(215.0, 100.0, False)]])
def test_a_point_keeps_the_part_that_it_lies_on(points):
    mask = grabcut.segment_box(two_plates(), BOX, points)
    assert mask[100, 100]
    assert mask[100, 215] == any(is_object for *_, is_object in points)


def test_a_point_outside_the_mask_is_told_by_its_line(tmp_path, caplog):
    path = tmp_path / "photo.png"
    Image.fromarray(two_plates()).save(path)
    layout = tmp_path / "layout.toml"
    layout.write_text(
        '[[object]]\nname = "plates"\nbox = [40, 40, 260, 160]\n'
        'point_prompts = [[100, 100], [215, 100], [160, 150, "out"]]\n'
    )
    loaded, photo = layout_config.read(layout), photograph.read(path)

    def only_left(rgb, box, points, text):
        mask = np.zeros(rgb.shape[:2], dtype=bool)
        mask[60:140, 60:140] = True
        return mask

    object_masks.segment_objects(loaded, photo, only_left)
    told = [record.getMessage() for record in caplog.records if "mask" in record.getMessage()]
    assert [line for line in told if "layout" in line] == [
        f"{layout}:4: object.plates.point_prompts: [215, 100] is not in the mask:"
        " give mask = 'file.png', or more points"
    ]
    caplog.clear()
    object_masks.segment_objects(loaded, photo, object_masks.grabcut)
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert told == [
        "'plates': its mask fills 36 % of its box: if parts are missing, add point_prompts on them"
    ]


def cup(shade: int = 150) -> np.ndarray:
    """A photograph of a red ring with a stem of three pixels, on gray."""
    y, x = np.mgrid[0:200, 0:300]
    noise = np.random.default_rng(4).integers(-4, 5, (200, 300, 3))
    rgb = np.full((200, 300, 3), shade) + noise
    away = np.hypot(x - 140, y - 100)
    red = ((away < 50) & (away > 18)) | ((abs(y - 100) < 2) & (x >= 190) & (x < 230))
    rgb[red] = (200, 40, 30) + noise[red]
    return np.clip(rgb, 0, 255).astype(np.uint8)


CUP = grabcut.Box(80, 40, 240, 160)


def test_a_thin_part_stays_where_a_point_lies_on_it():
    assert not grabcut.segment_box(cup(), CUP, [])[100, 215]
    mask = grabcut.segment_box(cup(), CUP, [(215.0, 100.0, True)])
    assert mask[100, 215] and mask[100, 200] and not mask[120, 215]


def test_a_hole_stays_open_where_a_point_lies_outside():
    assert grabcut.segment_box(cup(), CUP, [])[100, 140]
    mask = grabcut.segment_box(cup(), CUP, [(140.0, 100.0, False)])
    assert not mask[90:110, 130:150].any() and mask[100, 110]


def test_points_of_both_kinds_spread_alike():
    """Half of a plate is nearly of the table's color: a point on it decides about all of it."""
    y, x = np.mgrid[0:200, 0:300]
    rgb = np.full((200, 300, 3), 150, np.uint8)
    disc = np.hypot(x - 150, y - 100) < 60
    rgb[disc & (x < 150)] = (200, 40, 30)
    rgb[disc & (x >= 150)] = (170, 160, 130)
    rgb += np.random.default_rng(5).integers(0, 5, rgb.shape).astype(np.uint8)
    box = grabcut.Box(80, 30, 220, 170)
    half = disc & (x > 153)
    share = [
        grabcut.segment_box(rgb, box, [(110.0, 100.0, True), (180.0, 100.0, k)])[half].mean()
        for k in (True, False)
    ]
    assert share[0] > 0.97 and share[1] < 0.03, share


@pytest.mark.parametrize("seed", range(12))
def test_no_point_is_broken(seed):
    """Points at random on and outside of an object, in noise: each is obeyed."""
    random = np.random.default_rng(seed)
    rgb = two_plates() if seed % 2 else cup()
    rgb = np.clip(rgb + random.normal(0, 12, rgb.shape), 0, 255).astype(np.uint8)
    red = rgb[..., 0].astype(int) - rgb[..., 1] > 80
    box = BOX if seed % 2 else CUP
    places = [(x, y) for y, x in np.argwhere(np.ones(red.shape, bool)) if box.left + 8 < x
              < box.right - 8 and box.top + 8 < y < box.bottom - 8]  # fmt: skip
    chosen: list = []
    for k in random.permutation(len(places)):
        x, y = places[k]
        if len(chosen) < 8 and all(np.hypot(x - a, y - b) > 12 for a, b, _ in chosen):
            chosen.append((float(x), float(y), bool(red[y, x])))
    mask = grabcut.segment_box(rgb, box, chosen)
    assert [point for point in chosen if mask[int(point[1]), int(point[0])] != point[2]] == []


def warnings_of(tmp_path, caplog, rgb, keys, finder=object_masks.grabcut):
    """The warnings about an object of a layout in a photograph."""
    Image.fromarray(rgb).save(tmp_path / "photo.png")
    (tmp_path / "layout.toml").write_text(f'[[object]]\nname = "cup"\n{keys}\n')
    loaded = layout_config.read(tmp_path / "layout.toml")
    caplog.clear()
    object_masks.segment_objects(loaded, photograph.read(tmp_path / "photo.png"), finder)
    return [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]


def test_a_mask_that_is_hardly_right_is_told(tmp_path, caplog):
    def part_of(rgb, box, points, text):
        mask = np.zeros(rgb.shape[:2], dtype=bool)
        mask[90:110, 100:128] = True  # in the ring's color all around but for the hole
        return mask

    told = warnings_of(tmp_path, caplog, cup(), "box = [80, 40, 240, 160]", part_of)
    assert len(told) == 2
    assert told[0].startswith("'cup': its mask fills 3 % of its box: if parts are missing, add")
    assert "of the rim of its mask have the color of what lies outside" in told[1]
    assert warnings_of(tmp_path, caplog, two_plates(), "box = [50, 50, 150, 150]") == []


def test_a_point_outside_that_the_mask_holds_is_told(tmp_path, caplog):
    def everything(rgb, box, points, text):
        return np.hypot(*(np.mgrid[0:200, 0:300] - np.array([100, 140])[:, None, None])) < 52

    keys = 'box = [85, 45, 195, 155]\npoint_prompts = [[140, 100, "out"], [120, 70]]'
    (told,) = warnings_of(tmp_path, caplog, cup(), keys, everything)
    assert told == (
        f'{tmp_path / "layout.toml"}:4: object.cup.point_prompts: [140, 100, "out"] is in the'
        " mask: give mask = 'file.png', or more points"
    )
