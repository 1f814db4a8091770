"""Colors of a run's frames where they travel, from real runs and from numbers."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest

import vgmpi
from tests.support import drawn_runs
from vgmpi.gaussians.spherical_harmonics import C0
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.frame_colors import FOLDER, FrameColors
from vgmpi.postprocess.frames.frame_processes import render_in_processes
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.frames.render_config import LookSettings, Settings, SettingsError

# two colors that swirl into each other, and a solid that keeps its own
SCENE = """
[accuracy]
precision = "double"
[domain]
size = [0.4, 0.2, 0.3]
cell = 0.02
[time]
end = 0.2
frames = 6
[material.water]
kind = "fluid"
tait_coefficient = 2e4
viscosity = 0.1
[material.rubber]
kind = "elastic"
density = 700
youngs_modulus = 1e5
[[object]]
name = "blue"
material = "water"
color = "#2040c0"
shape = { box = [[0, 0, 0], [0.2, 0.2, 0.16]] }
[[object]]
name = "red"
material = "water"
color = "#c04020"
shape = { box = [[0.2, 0, 0], [0.4, 0.2, 0.08]] }
[[object]]
name = "ball"
material = "rubber"
color = "#20c040"
shape = { sphere = { center = [0.3, 0.1, 0.14], radius = 0.035 } }
"""
EYE = np.array([0.2, -1.0, 0.3])


def look(mode, **more):
    return LookSettings(color_transfer=mode, **more)


def rgb(run, index, chosen):
    """Colors of the frame's rows in 0..1, DC alone."""
    frame = Appearance(run, chosen).frame(index)
    sh = frame.get("sh", run.gaussians.sh[frame["id"]])
    return 0.5 + C0 * sh[:, 0].astype(np.float64)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The scene, and the same with half its time step."""
    folder = tmp_path_factory.mktemp("color")

    def make(name, **overrides):
        scene = vgmpi.load(folder / "scene.toml", overrides, text=SCENE)
        assert vgmpi.run(scene, folder / name).code == 0
        return folder / name

    return make("whole", **{"time.cfl": 0.4}), make("half", **{"time.cfl": 0.2})


MODES = [("frame", {}), ("relax", {"color_relaxation_time": 0.05})]


def rms(a):
    return np.sqrt((a**2).mean())


@pytest.mark.parametrize("mode, more", MODES)
def test_half_the_time_step_changes_a_frame_by_less_than_a_hundredth(made, mode, more):
    """Of the range 0..1 of colors, rms over all particles; reached 0.0035 and 0.0027. What the
    transfer itself does is ten times as much."""
    one, two = (RunReader(folder) for folder in made)
    assert not np.array_equal(one.frame(5)["positions"], two.frame(5)["positions"])
    a, b = (rgb(run, 5, look(mode, **more)) for run in (one, two))
    assert rms(a - b) < 0.01
    assert rms(a - rgb(one, 5, look("off"))) > 0.03


@pytest.mark.parametrize("mode, more", MODES)
def test_volume_times_color_is_kept_by_every_transfer(made, mode, more):
    run = RunReader(made[0])
    colors = FrameColors(run, look(mode, **more))
    frame = run.frame(5)
    volume = (run.gaussians.vol0[frame["id"]] * frame["J"])[colors.ids]
    before = colors.first if mode == "frame" else colors._relax_to(4, run.frame(4))
    after = colors._advance(frame, before, None if mode == "frame" else 0.8)
    total = volume @ before
    assert np.abs(after - before).max() > 0.1
    assert (np.abs(volume @ after - total) <= 1e-13 * (volume @ np.abs(before))).all()


def test_solids_keep_their_colors_and_equal_fluids_cost_nothing(made):
    run = RunReader(made[0])
    sh = Appearance(run, look("frame")).frame(5)["sh"]
    changed = (sh != run.gaussians.sh).any(axis=(1, 2))
    assert set(run.gaussians.object[changed]) == {0, 1}
    assert "sh" not in Appearance(run, look("frame", color_objects=["blue"])).frame(5)
    assert "sh" not in Appearance(run, look("off")).frame(5)


def test_a_picture_takes_the_colors_of_its_frame(made):
    run = RunReader(made[0])
    chosen = Appearance(run, look("frame"))
    frame = chosen.frame(5)
    s = chosen.splats(frame, EYE)
    want = np.maximum(0.5 + C0 * frame["sh"][:, 0], 0)
    np.testing.assert_allclose(s.color, want, atol=1e-6)
    assert rms(s.color - Appearance(run).splats(run.frame(5), EYE).color) > 0.03


def test_the_scene_says_how_and_render_toml_says_otherwise(made):
    run = RunReader(made[0])
    assert run.scene["appearance"]["color_transfer"] == "frame"
    np.testing.assert_array_equal(rgb(run, 5, LookSettings()), rgb(run, 5, look("frame")))
    run.scene["appearance"] |= {"color_transfer": "relax", "color_relaxation_time": 0.05}
    want = rgb(run, 5, look("relax", color_relaxation_time=0.05))
    np.testing.assert_array_equal(rgb(run, 5, LookSettings()), want)
    assert rms(rgb(run, 5, LookSettings(color_relaxation_time=0.2)) - want) > 0.01


def test_colors_carried_by_the_steps_stand_in_the_frames(tmp_path):
    told = {"appearance.color_transfer": "step", "time.frames": 3}
    scene = vgmpi.load(tmp_path / "scene.toml", told, text=SCENE)
    assert vgmpi.run(scene, tmp_path / "out").code == 0
    run = RunReader(tmp_path / "out")
    frame, chosen = run.frame(2), Appearance(run)
    sh = chosen.frame(2)["sh"]
    fluid = run.gaussians.object[frame["id"]] < 2
    np.testing.assert_array_equal(sh[fluid, 0], frame["color_sh"][fluid])
    np.testing.assert_array_equal(sh[~fluid], run.gaussians.sh[frame["id"]][~fluid])
    assert np.isnan(frame["color_sh"][~fluid]).all()
    shown = chosen.splats(chosen.frame(2), EYE).color[fluid]
    np.testing.assert_allclose(shown, np.maximum(0.5 + C0 * sh[fluid, 0], 0), atol=1e-6)
    # nearly one color; another look of the same run still knows those of the start
    assert shown.std(axis=0).max() < 0.5 * rgb(run, 2, look("frame"))[fluid].std(axis=0).max()
    assert "sh" not in Appearance(run, look("off")).frame(2)


def test_single_frames_are_those_of_a_row_of_frames(made):
    """Also from what an earlier call kept, whatever was drawn before."""
    chosen = look("relax", color_relaxation_time=0.07)
    run = RunReader(made[0])
    several = Appearance(run, chosen)
    row = [several.frame(k)["sh"] for k in range(6)]
    assert len(list((run.folder / FOLDER).glob("*.npz"))) == 5  # all but the first
    for k in (3, 0, 5, 1):
        np.testing.assert_array_equal(Appearance(RunReader(made[0]), chosen).frame(k)["sh"], row[k])
        np.testing.assert_array_equal(several.frame(k)["sh"], row[k])


def test_what_is_kept_is_taken_and_never_for_other_settings(made, monkeypatch):
    run = RunReader(made[0])
    want = Appearance(run, look("relax", color_relaxation_time=0.06)).frame(5)["sh"]
    moves = []
    inner = FrameColors._advance
    monkeypatch.setattr(FrameColors, "_advance", lambda *a: moves.append(0) or inner(*a))
    again = Appearance(RunReader(made[0]), look("relax", color_relaxation_time=0.06)).frame(5)["sh"]
    np.testing.assert_array_equal(again, want)
    assert not moves
    other = Appearance(RunReader(made[0]), look("relax", color_relaxation_time=0.03)).frame(5)["sh"]
    assert len(moves) == 5 and rms(other - want) > 0.01
    run.frames[2].touch()  # as if the run had been made again
    Appearance(RunReader(made[0]), look("relax", color_relaxation_time=0.03)).frame(5)
    assert len(moves) == 5 + 4


def test_a_broken_or_unwritable_cache_costs_time_only(made, caplog):
    run, chosen = RunReader(made[0]), look("relax", color_relaxation_time=0.05)
    want = Appearance(run, chosen).frame(3)["sh"]
    kept = run.folder / FOLDER / "frame_00003.npz"
    kept.write_bytes(kept.read_bytes()[:100])
    np.testing.assert_array_equal(Appearance(RunReader(made[0]), chosen).frame(3)["sh"], want)
    assert "frame_00003.npz: damaged: made anew" in caplog.text
    caplog.clear()
    for path in (run.folder / FOLDER).iterdir():
        path.unlink()
    (run.folder / FOLDER).rmdir()
    (run.folder / FOLDER).write_text("in the way")
    with caplog.at_level(logging.WARNING, "vgmpi"):
        np.testing.assert_array_equal(Appearance(RunReader(made[0]), chosen).frame(3)["sh"], want)
    (run.folder / FOLDER).unlink()
    assert len(caplog.records) == 1 and "cannot be kept" in caplog.text


def test_a_time_too_short_and_a_wrong_body_are_named(made):
    run = RunReader(made[0])
    with pytest.raises(
        SettingsError, match="color_relaxation_time: 1e-05 s is too short.*at least 0.0004"
    ):
        Appearance(run, look("relax", color_relaxation_time=1e-5)).frame(1)
    with pytest.raises(SettingsError, match="no body 'bleu'; known: blue, red, ball"):
        Appearance(run, look("frame", color_objects=["bleu"]))


def test_processes_that_share_the_frames_draw_the_same(made):
    small = {"picture": {"width": 64, "height": 48}}
    chosen = Settings(look=look("relax", color_relaxation_time=0.04), **small)
    painter = FrameRenderer(RunReader(made[0]), chosen, made[0])
    tasks = [(1, 0.0), (3, 0.5), (5, 1.0)]

    def pictures(jobs):
        return [views[0].picture for views in render_in_processes(painter, made[0], tasks, jobs)]

    alone = pictures(1)
    for path in (made[0] / FOLDER).iterdir():
        path.unlink()
    shared = pictures(2)
    np.testing.assert_array_equal(shared, alone)
    plain = FrameRenderer(
        RunReader(made[0]), Settings(look=look("off"), **small), made[0]
    ).views_of(5, 1.0)[0]
    assert (alone[-1] != plain.picture).any()


# ---- runs as numbers, without a solver -----------------------------------------------------------


def still(n=400, k=1, families=("fluid", "fluid"), sets=None, **look_of_scene):
    """Two bodies over each other at rest, in one frame. sets: what the files tell of who exchanges
    colors; None: a file from before that."""
    rng = np.random.default_rng(0)
    rest = SimpleNamespace(
        object=np.repeat([0, 1], n // 2),
        vol0=rng.uniform(0.5, 1.5, n) * 1e-6,
        sh=rng.normal(size=(n, k, 3)).astype("f4"),
        cov0=drawn_runs.diagonal(1e-4, 1e-4, 1e-4, n),
        opacity=np.full(n, 0.5, "f4"),
        digest="",
    )
    objects = [
        {
            "name": name,
            "family": family,
            "material": name,
            "phase": phase,
            "tracks_deformation": False,
        }
        for name, family, phase in zip(("a", "b"), families, look_of_scene.pop("phase", "pp"))
    ]
    for entry, number in zip(objects, sets or ()):
        entry["color_group"] = number
    scene = {"domain": {"cell": 0.05}, "appearance": look_of_scene}
    frame = {"id": np.arange(n), "positions": rng.uniform(0, 0.2, (n, 3)).astype("f4")}
    return SimpleNamespace(gaussians=rest, objects=objects, scene=scene), frame


def changed(run, frame, chosen):
    sh = FrameColors(run, chosen).at_frame(0, frame)
    return None if sh is None else sh != run.gaussians.sh


def means(run, frame, chosen):
    """Mean DC of each body after the transfer: equal where they exchange color."""
    sh = FrameColors(run, chosen).at_frame(0, frame)[:, 0]
    return sh[:200].mean(axis=0), sh[200:].mean(axis=0)


@pytest.mark.parametrize(
    "options, exchange",
    [
        ({}, True),
        ({"phase": "pq"}, False),
        ({"phase": "pq", "sets": (3, 3)}, True),
        ({"phase": "pq", "sets": (0, 1)}, False),
    ],
)
def test_the_files_tell_who_exchanges_color(options, exchange):
    run, frame = still(**options)
    run.gaussians.sh[200:] += 4
    a, b = means(run, frame, look("frame"))
    assert (abs(a - b).max() < 1.5) == exchange


def test_files_that_do_not_tell_who_mixes_are_named(caplog):
    run, _ = still()
    run.folder = "out"
    FrameColors(run, look("frame"))
    assert not caplog.records
    run.scene["coupling"] = [{"kind": "mixing", "between": ["a", "b"]}]
    FrameColors(run, look("frame"))
    assert "out: made by a version that did not tell which fluids" in caplog.text


@pytest.mark.parametrize("family", ["sand", "snow", "solid"])
def test_others_than_fluids_take_part_when_asked(family):
    run, frame = still(families=("fluid", family), phase="pq")
    assert set(np.flatnonzero(changed(run, frame, look("frame")).any(axis=(1, 2))) // 200) == {0}
    both = changed(run, frame, look("frame", color_objects=["a", "b"]))
    assert set(np.flatnonzero(both.any(axis=(1, 2))) // 200) == {0, 1}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_only_the_degrees_that_are_asked_for_travel(degree):
    run, frame = still(k=16)
    found = changed(run, frame, look("frame", color_sh_degree=degree))
    count = (degree + 1) ** 2
    assert found[:, :count].all() and not found[:, count:].any()


def test_of_bodies_that_turn_only_what_looks_alike_from_all_sides_travels():
    run, frame = still(k=4, families=("solid", "solid"))
    found = changed(run, frame, look("frame", color_sh_degree=1, color_objects=["a", "b"]))
    assert found[:, 0].all() and not found[:, 1:].any()


def test_volumes_of_now_are_the_weights():
    """A body blown up to three times its volume gives its color three times the weight."""
    run, frame = still()
    run.gaussians.sh[:200], run.gaussians.sh[200:] = 0, 1
    run.gaussians.vol0[:] = 1e-6
    even = FrameColors(run, look("frame")).at_frame(0, frame)[:, 0].mean()
    J = np.repeat([1.0, 3.0], 200)
    more = FrameColors(run, look("frame")).at_frame(0, {**frame, "J": J})[:, 0].mean()
    assert even == pytest.approx(0.5, abs=0.03) and more == pytest.approx(0.75, abs=0.03)


def test_the_order_of_rows_is_nothing_and_rows_may_be_missing():
    run, frame = still()
    whole = FrameColors(run, look("frame")).at_frame(0, frame)
    order = np.random.default_rng(1).permutation(400)
    turned_round = {k: a[order] for k, a in frame.items()}
    mixed = FrameColors(run, look("frame")).at_frame(0, turned_round)
    np.testing.assert_array_equal(mixed, whole[order])
    colors = FrameColors(run, look("frame"))  # all digits: pictures have single precision only
    one, other = (colors._advance(f, colors.first, 0.5) for f in (frame, turned_round))
    np.testing.assert_array_equal(one, other)
    part = FrameColors(run, look("frame")).at_frame(0, {k: a[::2] for k, a in frame.items()})
    assert part.shape == (200, 1, 3) and not np.array_equal(part, whole[::2])


def test_a_run_that_says_nothing_of_colors_keeps_them():
    run, frame = still()
    assert changed(run, frame, LookSettings()) is None
    run.scene = {}
    assert changed(run, frame, LookSettings()) is None
    with pytest.raises(SettingsError, match="size of a cell"):
        FrameColors(run, look("frame"))
