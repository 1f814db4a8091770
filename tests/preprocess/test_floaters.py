"""Size and place of a capture by what is seen: floaters do not count."""

import logging
import re

import numpy as np
import pytest

import vgmpi
from tests.preprocess.test_interior_fill import shell
from tests.support.small_scenes import PEBBLE
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.preprocess.capture_selection import find_floaters
from vgmpi.preprocess.inspect_file import describe_file
from vgmpi.preprocess.object_builder import build_object

COUNT = 2000
SCENE = (
    PEBBLE
    + """
[[object]]
name = "thing"
gaussians = "thing.ply"
position = [0.32, 0.32, 0.1]
"""
)
BODY = 'material = "rubber"\nheight = 0.3\n'


def ball():
    """A ball of radius 0.5 around the origin, as a capture has it: a skin of flat Gaussians."""
    return shell(0.5, COUNT, np.zeros(3))


def joined(a, b):
    """Two clouds as one."""
    names = ("x", "quat", "scale", "opacity", "sh")
    return GaussianCloud(*(np.concatenate([getattr(a, n), getattr(b, n)]) for n in names))


def group(middle, opacity, count=1, size=0.006):
    """Gaussians around a point, a hundredth apart."""
    x = np.asarray(middle) + np.random.default_rng(3).normal(0, 0.01, (count, 3))
    quat, ones = np.tile([1.0, 0, 0, 0], (count, 1)), np.ones(count)
    return GaussianCloud(
        x, quat, np.full((count, 3), size), opacity * ones, np.zeros((count, 1, 3))
    )


def build(tmp_path, cloud, keys=BODY):
    """The object of a scene with this capture."""
    registry.write(tmp_path / "thing.ply", cloud)
    return build_object(vgmpi.load(tmp_path / "scene.toml", text=SCENE + keys), 1)


FLOATERS = {
    "opaque, a third of the size away": group([0, 0, -0.9], 0.95),
    "faint": group([0, 0, -2], 0.02),
    "clump of 40": group([0, -3, -3], 0.02, 40),
    "very faint, very far": group([0, 0, -10], 0.006),
    "absurdly far": group([1e12, 0, 0], 0.9),
    "wide and far": group([0, 5, 0], 0.01, size=3.0),
}


@pytest.mark.parametrize("name", FLOATERS)
@pytest.mark.parametrize("size", ["height = 0.3", "scale = 0.3"])
def test_floaters_set_neither_size_nor_place(tmp_path, caplog, name, size):
    """The ball is 0.3 m tall, stands on its place and has the volume of a ball without them."""
    floaters = FLOATERS[name]
    with caplog.at_level(logging.WARNING, "vgmpi"):
        built = build(tmp_path, joined(ball(), floaters), f'material = "rubber"\n{size}\n')
        assert len(caplog.messages) == 1
        alone = build(tmp_path, ball(), f'material = "rubber"\n{size}\n')
        assert len(caplog.messages) == 1  # nothing is left out of the ball alone
    skin = built.cloud.x[:COUNT, 2]
    assert np.ptp(skin) == pytest.approx(0.3, rel=0.002)
    assert skin.min() == pytest.approx(0.1, abs=1e-9)
    assert built.volume.sum() == pytest.approx(alone.volume.sum(), rel=1e-6)
    assert built.volume.sum() == pytest.approx(4 / 3 * np.pi * 0.15**3, rel=0.05)
    line = caplog.messages[0]
    assert line.startswith(f"'thing': {len(floaters)} of {COUNT + len(floaters):,} Gaussians (")
    share = 100 * floaters.opacity.sum() / (floaters.opacity.sum() + 0.95 * COUNT)
    told = float(re.search(r"\(([0-9.e-]+) % of the opacity\)", line)[1])
    assert told == pytest.approx(share, rel=0.06)


def test_the_selection_of_the_line_gives_the_same_body(tmp_path, caplog):
    """What the line says to paste: the same particles, and the line is gone."""
    cloud = joined(ball(), group([0, -3, -3], 0.02, 40))
    built = build(tmp_path, cloud)
    box = re.search(r"select = (\{ box = .*?\} ?\}|\{ box = .*?\]\] \})", caplog.messages[0])[1]
    caplog.clear()
    pasted = build(tmp_path, cloud, f"{BODY}select = {box}\n")
    assert not caplog.messages
    assert np.array_equal(built.cloud.x, pasted.cloud.x)


def test_floaters_that_are_kept(tmp_path, caplog):
    """`keep_floaters` counts all, as the files say."""
    cloud = joined(ball(), group([0, 0, -0.9], 0.95))
    built = build(tmp_path, cloud, f"{BODY}select = {{ keep_floaters = true }}\n")
    assert np.ptp(built.cloud.x[:COUNT, 2]) == pytest.approx(0.3 / 1.4, rel=0.02)
    assert not caplog.messages


def test_a_wide_faint_gaussian_in_the_middle_is_harmless(tmp_path, caplog):
    """It is no floater, and does not change the size."""
    built = build(
        tmp_path, joined(ball(), group([0, 0, 0], 0.006, size=5.0)), f"{BODY}fill = false"
    )
    assert np.ptp(built.cloud.x[:, 2]) == pytest.approx(0.3, rel=0.002)
    assert len(built.cloud) > COUNT and not caplog.messages


def test_parts_that_stand_apart_are_no_floaters():
    """Equal parts, a part of a tenth, sparse captures and few Gaussians are whole."""
    far = shell(0.5, COUNT, np.array([3.0, 0, 0]))
    tenth = shell(0.15, COUNT // 10, np.array([0, 0, 1.2]))
    for cloud in (ball(), joined(ball(), far), joined(ball(), tenth), shell(0.5, 60, np.zeros(3))):
        assert find_floaters(cloud) is None
    assert find_floaters(ball().select(slice(0, 5))) is None


def test_scenery_keeps_its_background(tmp_path, caplog):
    """Floaters of scenery are drawn where they are, but do not set its size."""
    cloud = joined(ball(), group([0, 0, 3], 0.02, 40))
    for collider in ("false", "true"):
        keys = f'role = "scenery"\ncollider = {collider}\nheight = 0.3\n'
        built = build(tmp_path, cloud, keys)
        assert len(built.cloud) == len(cloud)
        assert np.ptp(built.cloud.x[:COUNT, 2]) == pytest.approx(0.3, rel=0.002)
        assert built.cloud.x[COUNT:, 2].min() > 0.6
    assert (
        built.collider.distance(np.array([[0.32, 0.32, 0.25], [0.32, 0.32, 0.5]])) < 0
    ).tolist() == [
        True,
        False,
    ]
    assert "do not count for its size and place" in caplog.messages[0]


def test_inspect_tells_of_floaters(tmp_path):
    """Their number and share, and what the others reach."""
    registry.write(tmp_path / "a.ply", joined(ball(), group([0, 0, -10], 0.02, 40)))
    line = describe_file(tmp_path / "a.ply").splitlines()[-1]
    assert line.startswith("  floaters 40 (0.042 % of the opacity); the others reach x -0.49")
    registry.write(tmp_path / "b.ply", ball())
    assert "  floaters" not in describe_file(tmp_path / "b.ply")


def test_an_origin_without_a_size_keeps_all(tmp_path, caplog):
    """Nothing depends on the extent there."""
    keys = 'role = "scenery"\nscale = 0.3\norigin = [0.3, 0.3, 0.3]\n'
    text = SCENE.replace("position = [0.32, 0.32, 0.1]\n", "") + keys
    registry.write(tmp_path / "thing.ply", joined(ball(), group([0, 0, 3], 0.02)))
    built = build_object(vgmpi.load(tmp_path / "scene.toml", text=text), 1)
    assert len(built.cloud) == COUNT + 1 and not caplog.messages
