"""Where bodies stand: on the floor, on each other, in the air, and apart."""

import numpy as np
import pytest

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.tools.photo.layout_config import ObjectTable
from vgmpi.tools.photo.object_placement import PlacingError, UnplacedObject, place
from vgmpi.tools.photo.photo_camera import View

VIEW, EYE = View(640, 480, 40.0, 20.0), 0.3


def box(low, high, count=9):
    """A block of Gaussians about the eye [m], which is EYE above the floor."""
    axes = [np.linspace(a, b, count) for a, b in zip(low, high)]
    x = np.stack(np.meshgrid(*axes), -1).reshape(-1, 3) - (0, 0, EYE)
    n = len(x)
    return GaussianCloud(x, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 1e-3), np.full(n, 0.9),
                 np.zeros((n, 1, 3), np.float32))  # fmt: skip


def seen(name, low, high, count=9, **told):
    """As the camera sees it: at a distance of which it knows nothing."""
    far = 1 / np.mean([low[1], high[1]])
    return UnplacedObject(
        ObjectTable(name=name, **told), box(low, high, count).transformed(np.eye(3), far)
    )


def corners(placed, k):
    return np.array(placed.objects[k].floor_box(placed.eye))


LOW = ("under", (-0.1, 0.5, 0.0), (0.1, 0.7, 0.1))
UPPER = ("upper", (-0.03, 0.57, 0.1), (0.03, 0.63, 0.16))
BESIDE = ("beside", (0.2, 0.8, 0.0), (0.3, 0.9, 0.12))
AIR = ("air", (-0.3, 0.6, 0.15), (-0.2, 0.7, 0.2))


def test_one_height_tells_all():
    things = [seen(*LOW), seen(*UPPER, support="under"), seen(*BESIDE, height=0.12)]
    placed = place([*things, seen(*AIR, support=0.15)], VIEW.forward, None)
    assert placed.eye == pytest.approx(EYE, rel=1e-9)
    for k, (_, low, high) in enumerate((LOW, UPPER, BESIDE, AIR)):
        assert np.allclose(corners(placed, k), [low, high], atol=1e-9)
    said = "\n".join(placed.lines)
    assert "on 'under'" in said and "nothing holds it up, it falls" in said
    assert "by the height of 'beside'" in said


@pytest.mark.parametrize("which, height", [(UPPER, 0.06), (AIR, 0.05)])
def test_heights_of_what_does_not_stand_on_the_floor_tell_it_too(which, height):
    support = {"upper": "under", "air": 0.15}[which[0]]
    things = [seen(*LOW), seen(*which, support=support, height=height)]
    placed = place(things, VIEW.forward, None)
    assert placed.eye == pytest.approx(EYE, rel=1e-9)
    assert np.allclose(corners(placed, 1), which[1:], atol=1e-9)


def test_heights_that_do_not_agree_are_told():
    things = [seen(*LOW, height=0.1), seen(*BESIDE, height=0.24)]
    placed = place(things, VIEW.forward, None)
    said = "\n".join(placed.lines)
    assert "they differ by a factor of 2" in said and "times as large as it is seen" in said
    assert placed.eye == pytest.approx(1.5 * EYE, rel=1e-6)  # the middle of both
    assert np.ptp(corners(placed, 1)[:, 2]) == pytest.approx(0.24)


def test_distance_and_height_by_hand_are_both_obeyed():
    thing = seen(*BESIDE, height=0.2, distance=1.3)
    placed = place([thing], VIEW.forward, EYE)
    low, high = corners(placed, 0)
    assert low[2] == pytest.approx(0) and high[2] == pytest.approx(0.2)
    assert placed.objects[0].distance(VIEW.forward) == pytest.approx(1.3)
    # it stands in the direction in which it is seen
    assert (low + high)[0] / (low + high)[1] == pytest.approx(0.25 / 0.85)


def test_a_second_pass_with_what_was_found_changes_nothing():
    things = [seen(*LOW), seen(*UPPER, support="under"), seen(*BESIDE, height=0.12)]
    first = place(things, VIEW.forward, None)
    again = []
    for one, stand in zip(things, first.objects):
        low, high = stand.floor_box(first.eye)
        more = {"height": high[2] - low[2], "distance": stand.distance(VIEW.forward)}
        again.append(one._replace(config=one.config.model_copy(update=more)))
    second = place(again, VIEW.forward, first.eye)
    for k in range(3):
        assert np.allclose(corners(first, k), corners(second, k), atol=1e-9)
    assert not any("times as large" in line for line in second.lines)


def test_bodies_that_lie_in_each_other_are_parted():
    behind = ("behind", (-0.1, 0.65, 0.0), (0.1, 0.85, 0.1))  # 5 cm of it are in the other
    placed = place([seen(*LOW, 40), seen(*behind, 40, height=0.1)], VIEW.forward, EYE)
    near, far = corners(placed, 0), corners(placed, 1)
    assert np.allclose(near, LOW[1:], atol=1e-9)
    assert near[1, 1] - 0.01 < far[0, 1] < near[1, 1] + 0.02
    (said,) = [line for line in placed.lines if "lay in" in line]
    assert said.startswith("'behind': lay in 'under', moved 0.0")


def test_what_lies_beside_its_support_falls():
    aside = ("upper", (0.27, 0.57, 0.1), (0.33, 0.63, 0.16))
    placed = place([seen(*LOW, height=0.1), seen(*aside, support="under")], VIEW.forward, None)
    assert any("beside 'under', which does not hold it up: it falls" in s for s in placed.lines)


@pytest.mark.parametrize(
    "things, needle",
    [
        ([seen(*LOW)], "give the height of at least one object"),
        ([seen("high", (0, 0.5, 0.4), (0.1, 0.6, 0.5), height=0.1)], "above the horizon"),
        ([seen(*UPPER, support=0.4, height=0.06)], "is seen below the eye"),
    ],
)
def test_what_has_no_place_is_told(things, needle):
    with pytest.raises(PlacingError, match=needle):
        place(things, VIEW.forward, EYE if things[0].config.support else None)
