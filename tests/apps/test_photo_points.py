"""Points that lie on an object decide its mask; one that the mask misses is told by its line."""

import numpy as np
import pytest
from PIL import Image

from vgmpi.apps.photo import grabcut, layout_config, object_masks, photograph

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
    mask = grabcut.grabcut(two_plates(), BOX, points)
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
    assert told == [
        f"{layout}:4: object.plates.point_prompts: [215, 100] is not in the mask:"
        " give mask = 'file.png', or more points"
    ]
    caplog.clear()
    object_masks.segment_objects(loaded, photo, object_masks.grabcut)
    assert not [record for record in caplog.records if record.levelname == "WARNING"]
