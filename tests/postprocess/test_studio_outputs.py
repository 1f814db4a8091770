"""What every way to draw owes, of the studio: pictures that do not depend on who draws them, what
is transparent, depths, several cameras, lenses and shutters."""

import importlib
import pkgutil
import time

import imageio.v3 as iio
import numpy as np
import pytest

import vgmpi.postprocess.studio
from tests.support import drawn_runs
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import render
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

SMALL = "[picture]\nwidth = 64\nheight = 48\n"
DRAW = ("-m", "vgmpi", "render")
TWO = '[[camera]]\nname = "south"\nazimuth = 0\n[[camera]]\nname = "east"\nazimuth = 90\n'
CLEAR = 'background = "none"\n'
# the bar is in the middle of the picture, 2.5 m away
BAR = '[camera]\nkind = "fixed"\neye = [0.5, -2, 0.85]\ntarget = [0.5, 0.5, 0.85]\n'
FRAMES = 3


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=FRAMES)


def draw(out, folder, text, *argv):
    """Call the command with a render.toml; it must succeed."""
    (folder / "render.toml").write_text(SMALL + text)
    assert render.main([str(out), str(folder / "render.toml"), "-q", *map(str, argv)]) == 0


def painter(out, folder, text, **options):
    (folder / "render.toml").write_text(SMALL + text)
    chosen = render_config.load(folder / "render.toml")
    assert chosen.studio
    return FrameRenderer(RunReader(out), chosen, folder, **options)


def pictures(folder):
    return {str(path.relative_to(folder)): iio.imread(path) for path in folder.rglob("*.png")}


def same(one, other):
    assert one.keys() == other.keys()
    for name, picture in one.items():
        np.testing.assert_array_equal(picture, other[name], name)


def test_a_picture_is_the_same_when_drawn_twice(out, tmp_path):
    """By the same painter, behind another frame, and by another painter."""
    mine = painter(out, tmp_path, "")
    first = mine.draw(1)
    mine.draw(2)
    np.testing.assert_array_equal(mine.draw(1), first)
    np.testing.assert_array_equal(painter(out, tmp_path, "").draw(1), first)


def test_processes_share_the_frames_without_changing_them(out, tmp_path):
    for jobs in (1, 2):
        draw(
            out, tmp_path, "[camera]\nrevolutions = 1\n", "-o", tmp_path / str(jobs), "--jobs", jobs
        )
    one, two = (pictures(tmp_path / jobs) for jobs in "12")
    assert len(one) == FRAMES
    same(one, two)


def test_cameras_draw_as_if_they_were_alone(out, tmp_path):
    both = painter(out, tmp_path, TWO).views_of(1, 0.0)
    south, east = (one.picture for one in both)
    assert np.abs(south.astype(int) - east).mean() > 2
    for angle, got in ((0, south), (90, east)):
        alone = painter(out, tmp_path, f"[camera]\nazimuth = {angle}\n").draw(1)
        np.testing.assert_array_equal(got, alone)


@pytest.mark.parametrize("more", ["", "floor = { kind = 'none' }\n", CLEAR])
def test_opacity_and_depth_of_the_pictures(out, tmp_path, more):
    alone = tmp_path / "alone"
    shown = ["-o", tmp_path / "p", "--alpha", tmp_path / "alpha", "--depth", tmp_path / "depth"]
    draw(out, tmp_path, more + BAR, *shown)
    alpha = iio.imread(tmp_path / "alpha" / "frame_00000.png")
    depth = np.load(tmp_path / "depth" / "frame_00000.npy")
    assert alpha.dtype == np.uint16 and depth.dtype == np.float32
    assert alpha.shape == depth.shape == (48, 64)
    assert alpha[24, 32] > 60000 and depth[24, 32] == pytest.approx(2.5, abs=0.05)
    # nothing stands above; the floor, if there is one, is no part of what is shown
    assert alpha[0, 0] == 0 and np.isinf(depth[0, 0])
    assert not np.isnan(depth).any() and (depth > 0).all()
    # the numbers do not change the picture
    draw(out, tmp_path, more + BAR, "-o", alone)
    same(pictures(tmp_path / "p"), pictures(alone))


def test_opacities_are_shares(out, tmp_path):
    image, left, depth = painter(out, tmp_path, BAR, alpha=True, depth=True).pixels_of(1, 0.0)[0]
    for name, values in (("picture", image), ("left", left)):
        assert np.isfinite(values).all(), name
        assert values.min() >= -1e-6 and values.max() <= 1 + 1e-6, name
    assert np.isfinite(depth[left < 0.1]).all()  # where it is opaque, it is somewhere
    assert left.max() == 1 and left.min() < 0.05


def test_a_clear_background_leaves_the_corners_transparent(out, tmp_path):
    draw(out, tmp_path, CLEAR, "-o", tmp_path / "a.png")
    picture = iio.imread(tmp_path / "a.png")
    assert picture.shape == (48, 64, 4)
    assert (picture[:: 48 - 1, :: 64 - 1, 3] == 0).all() and picture[..., 3].max() > 200
    assert np.ptp(picture[..., 3].astype(int)) > 200


def test_a_clear_picture_over_a_color_is_nearly_the_picture_on_it(out, tmp_path):
    """Of solids; what is seen through water is bent and mirrored, and is there only once."""
    plain = 'background = "#204060"\ntone_mapping = "neutral"\nfloor = { kind = "none" }\n'
    clear, want = (
        painter(out, tmp_path, one + BAR).draw(0).astype(float) for one in (CLEAR, plain)
    )
    alpha = clear[..., 3:] / 255
    got = clear[..., :3] * alpha + np.array([0x20, 0x40, 0x60]) * (1 - alpha)
    off, bar = np.abs(got - want), (slice(23, 25), slice(28, 36))
    assert alpha[bar].min() > 0.95
    assert off[bar].max() < 6  # light is added up before it is made display values
    assert off[alpha[..., 0] == 0].max() < 2


@pytest.mark.parametrize("color", ["#ffffff", "#000000", "#204060", "#00ff00", "#c01030"])
def test_a_background_has_the_color_that_was_asked_for(out, tmp_path, color):
    """Also one that the tone curve gives no light."""
    picture = painter(out, tmp_path, f'background = "{color}"\n{BAR}').draw(1)
    want = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    np.testing.assert_allclose(picture[0, 0], want, atol=2)


@pytest.mark.parametrize("colors", [((0, 200, 0), (180, 60, 200)), ((0, 255, 0), (255, 230, 40))])
def test_a_photograph_is_shown_as_it_is(out, tmp_path, colors):
    photograph = np.full((48, 64, 3), colors[0], np.uint8)
    photograph[:, 32:] = colors[1]
    iio.imwrite(tmp_path / "photo.png", photograph)
    picture = painter(out, tmp_path, 'background = "photo.png"\n' + BAR).draw(1).astype(int)
    assert np.abs(picture - photograph)[:12].max() <= 2


@pytest.mark.parametrize("floor", ["", "floor = { height = 0 }\n"])
def test_a_photograph_stands_behind(out, tmp_path, floor):
    """As it is, where nothing is before it; darker, where the floor takes a shadow."""
    photograph = np.full((48, 64, 3), (0, 200, 0), np.uint8)
    photograph[:, 32:] = (180, 60, 200)
    iio.imwrite(tmp_path / "photo.png", photograph)
    draw(out, tmp_path, f'background = "photo.png"\n{floor}', "-o", tmp_path / "a.png")
    picture = iio.imread(tmp_path / "a.png").astype(int)
    off = np.abs(picture - photograph).max(axis=2)
    assert off[0].max() <= 2  # above everything
    assert (off <= 2).mean() > 0.2 and (off > 30).mean() > 0.1


def test_an_open_shutter_smears_what_moves(out, tmp_path):
    """And nothing else: the bar's neighbourhood and the water move, the sky does not."""
    more = BAR + "[video]\nshutter = %s\n"
    still, open_ = (
        painter(out, tmp_path, "blur_samples = 4\n" + more % share).draw(1).astype(int)
        for share in (0, 1)
    )
    off = np.abs(still - open_).max(axis=2)
    assert off.max() > 8 and off[:4].max() <= 1
    again = painter(out, tmp_path, "blur_samples = 4\n" + more % 1).draw(1)
    np.testing.assert_array_equal(again, open_)


def test_an_aperture_blurs_what_is_not_in_focus(out, tmp_path):
    steep, spent = {}, {}
    for focus in (None, 2.5, 0.8):
        lens = "" if focus is None else f"aperture = 0.08\nfocus = {focus}\n"
        mine = painter(out, tmp_path, "blur_samples = 16\n" + BAR + lens)
        mine.draw(1)  # compiles
        began = time.process_time()
        picture = mine.draw(1).astype(int)
        spent[focus] = time.process_time() - began
        steep[focus] = np.abs(np.diff(picture[18:31, 20:45], axis=0)).sum()  # at the bar
    assert steep[0.8] < 0.6 * steep[None]
    assert steep[2.5] > 0.8 * steep[None]
    assert spent[0.8] < 2 * spent[None] + 0.1  # one picture, not one for each of the samples


def test_finer_pictures_show_the_same(out, tmp_path):
    coarse = painter(out, tmp_path, "").draw(1).astype(int)
    fine = painter(out, tmp_path, "supersample = 2\n").draw(1).astype(int)
    assert coarse.shape == fine.shape and 0 < np.abs(coarse - fine).mean() < 4


def test_a_preview_is_a_small_picture_of_the_same(out, tmp_path):
    whole = painter(out, tmp_path, "").draw(1).astype(int)
    quick = painter(out, tmp_path, "", longest=64).draw(1).astype(int)
    assert quick.shape == whole.shape and np.abs(quick - whole).mean() < 6


def test_a_run_of_one_frame_of_one_body_is_drawn(tmp_path):
    """Nothing flows, nothing lies below, and there is no domain."""
    out = drawn_runs.write(tmp_path / "out", frames=1, scene=False)
    picture = painter(out, tmp_path, "").draw(0)
    assert picture.shape == (48, 64, 3) and np.ptp(picture.astype(int)) > 60


def test_rounding_does_not_depend_on_what_was_compiled_before():
    """With fastmath 515 pixels of the splash changed when tests had compiled functions first."""
    count = 0
    for found in pkgutil.iter_modules(vgmpi.postprocess.studio.__path__):
        module = importlib.import_module(f"vgmpi.postprocess.studio.{found.name}")
        for name, function in vars(module).items():
            options = getattr(function, "targetoptions", None)
            if options is not None:
                assert not options.get("fastmath"), f"{found.name}.{name}"
                count += 1
    assert count > 60
