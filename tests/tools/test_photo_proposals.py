"""--find where rows are not plain: nothing on empty tables, objects that fill their rows."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from vgmpi.tools.photo import box_proposals, example_photographs, grabcut

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
HEIGHT, WIDTH = 400, 600
Y, X = np.mgrid[:HEIGHT, :WIDTH]


def noise(seed, width):
    """Smooth noise of variance 1; width: its extent [pixels] down and across."""
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=Y.shape), width)
    return (smooth / smooth.std())[..., None]


def tinted(color, change):
    grain = np.random.default_rng(9).normal(0, 5, (HEIGHT, WIDTH, 1))
    return np.clip(np.array(color) + change + grain, 0, 255).astype(np.uint8)


def wood():
    return tinted((150, 95, 55), 14 * noise(0, (1, 60)))


EMPTY = {
    "wood": wood,
    "cloth": lambda: tinted((120, 120, 140), 12 * noise(1, 40)),
    "a wall and wood": lambda: np.where((Y < 150)[..., None], (200, 205, 190), wood()),
    "a lamp's light": lambda: tinted(
        (160, 150, 140), 45 - (((X - 300) ** 2 + (Y - 200) ** 2) / 1100)[..., None]
    ),
    "tiles": lambda: np.where(
        ((X // 60 + Y // 60) % 2 == 0)[..., None], tinted((180, 180, 175), 0), tinted((90,) * 3, 0)
    ),
    "bricks": lambda: np.where(
        ((Y % 40 < 4) | ((X + Y // 40 % 2 * 45) % 90 < 4))[..., None],
        tinted((190, 185, 180), 0), tinted((150, 70, 50), 0),
    ),
    "grass": lambda: tinted((70, 120, 40), 25 * noise(2, (3, 1))),
}  # fmt: skip


@pytest.mark.parametrize("name", EMPTY)
def test_an_empty_table_has_no_proposals(name):
    rgb = EMPTY[name]().astype(np.uint8)
    assert box_proposals.propose_boxes(rgb) == []


@pytest.mark.parametrize("radii", [(230, 120), (280, 190)])
def test_a_dish_that_fills_its_rows_is_proposed(radii):
    """More than half of its rows, so that their medians are its own colors."""
    inside = ((X - 310) / radii[0]) ** 2 + ((Y - 200) / radii[1]) ** 2 < 1
    rgb = np.where(inside[..., None], tinted((60, 90, 150), 0), wood())
    (box,) = box_proposals.propose_boxes(rgb.astype(np.uint8))
    overlap = grabcut.box_overlap(box, grabcut.box_of(inside))
    print(f"{radii}: {overlap:.3f}")
    assert overlap > 0.78  # it is widened by 6 % on each side
    assert box_proposals.saliency_boxes(rgb.astype(np.uint8)) != [box]


def true_boxes(name):
    """Boxes of an example's layout, or of its masks."""
    if name == "chelsea":
        return {"cat": grabcut.Box(0, 0, 402, 300)}
    folder = example_photographs.FOLDER / name / "masks"
    return {
        path.stem: grabcut.box_of(np.asarray(Image.open(path).convert("L")) > 127)
        for path in folder.iterdir()
    }


# of the cup without its saucer and its side; of all but the rocket's tip
@pytest.mark.parametrize(
    "name, object_name, required, most",
    [("coffee", "cup", 0.6, 2), ("rocket", "rocket", 0.45, 1), ("chelsea", "cat", 0.8, 2)],
)
def test_real_photographs(name, object_name, required, most):
    data = pytest.importorskip("skimage.data", reason="scikit-image has the photographs")
    boxes = box_proposals.propose_boxes(np.ascontiguousarray(getattr(data, name)()))
    true = true_boxes(name)[object_name]
    overlap = max(grabcut.box_overlap(box, true) for box in boxes)
    print(f"{name}: {len(boxes)} proposed, '{object_name}' with overlap {overlap:.2f}")
    assert overlap > required and len(boxes) <= most


def test_the_cup_with_its_saucer_is_proposed():
    """The box that was drawn by hand around all of it."""
    data = pytest.importorskip("skimage.data", reason="scikit-image has the photographs")
    from tests.tools.test_photo_coffee import BOX

    boxes = box_proposals.propose_boxes(np.ascontiguousarray(data.coffee()))
    overlap = max(grabcut.box_overlap(box, BOX) for box in boxes)
    print(f"cup and saucer: {overlap:.2f}")
    assert overlap > 0.8


def test_a_part_is_proposed_beside_its_whole_only_if_it_is_large():
    whole = grabcut.Box(0, 0, 100, 100)
    assert box_proposals._is_separate(grabcut.Box(20, 20, 75, 75), whole)
    assert not box_proposals._is_separate(grabcut.Box(20, 20, 50, 50), whole)
    assert not box_proposals._is_separate(grabcut.Box(5, 5, 95, 95), whole)
    assert box_proposals._is_separate(grabcut.Box(80, 80, 180, 180), whole)
