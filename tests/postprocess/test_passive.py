"""Gaussians without mass: bound to particles at rest, in the file, moved by them when drawn."""

from dataclasses import asdict
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import vgmpi
from tests.preprocess.test_prune import GUITAR, SCENE, duck_obj
from tests.support.small_scenes import scene
from vgmpi.gaussians import shape_evolution, spherical_harmonics
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunReader, inspect
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.postprocess.commands import export
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.render_config import LookSettings
from vgmpi.postprocess.raster.rasterize import render
from vgmpi.preprocess.built_object import CARRIERS, bind_passive
from vgmpi.preprocess.pruning import image_similarity
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import prepare, write_initial_particles

RIDING = 'mesh = "duck.obj"\nprune = "auto"\npassive_gaussians = true'
EYE = np.array([2.0, 1.0, 0.5])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("passive")
    (path / "duck.obj").write_text(duck_obj(24))
    return path


def made(folder, keys):
    return build_scene(scene(folder, SCENE.replace("SOURCE", keys)))


@pytest.fixture(scope="module")
def riding(folder):
    return made(folder, RIDING)


def look_of(prepared, chosen=None):
    """What a renderer does with the file that these particles would become."""
    names = ("vol0", "object", "cov0", "opacity", "sh")
    rest = SimpleNamespace(x0=prepared.x, **{n: getattr(prepared, n) for n in names})
    if prepared.passive is not None:
        riders = asdict(prepared.passive)
        rest.passive = SimpleNamespace(x0=riders.pop("x"), **riders)
    return Appearance(SimpleNamespace(gaussians=rest, objects=prepared.objects), chosen)


def moved(prepared, F, shift):
    """The frame after an affine motion x -> F x + shift."""
    n = len(prepared.x)
    frame = {"id": np.arange(n), "positions": prepared.x @ F.T + shift, "J": np.ones(n)}
    return frame | {"F": np.tile(F.ravel(), (n, 1))}


AFFINE = np.array([[1.1, 0.2, 0.0], [-0.3, 0.9, 0.1], [0.05, 0.0, 1.05]])


def test_weights_add_up_and_do_not_jump():
    random = np.random.default_rng(0)
    x = random.random((300, 3))
    start, end = random.random(3), random.random(3)
    line = start + np.linspace(0, 1, 4001)[:, None] * (end - start)
    rows, weights = bind_passive(x, line)
    assert rows.shape == weights.shape == (4001, CARRIERS)
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-14) and weights.min() >= 0
    dense = np.zeros((4001, 300))
    np.add.at(dense, (np.arange(4001)[:, None], rows), weights)
    assert np.abs(np.diff(dense, axis=0)).max() < 0.05  # though neighbours change on the way
    assert np.allclose(bind_passive(x, x[7:8])[1].max(), 1.0)  # where a particle is, it has it all


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_particles_carry_all(count):
    x = np.random.default_rng(1).random((count, 3))
    rows, weights = bind_passive(x, x[:1] + 0.1)
    assert rows.shape == (1, CARRIERS) and rows.max() < count
    assert weights.sum() == pytest.approx(1, abs=1e-14) and np.all(weights >= 0)
    rows, weights = bind_passive(np.zeros((6, 3)), np.ones((1, 3)))  # all equally far away
    assert np.allclose(weights, 1 / CARRIERS)


def test_affine_motion_is_followed_exactly(riding):
    shift = np.array([0.1, -0.2, 0.05])
    splats = look_of(riding).splats(moved(riding, AFFINE, shift), EYE)
    own, riders = len(riding.x), riding.passive
    assert len(splats.x) == own + len(riders.x) > 5 * own
    assert np.abs(splats.x[own:] - (riders.x @ AFFINE.T + shift)).max() < 1e-7  # weights: single
    want = shape_evolution.deformed_covariance(
        riders.cov0, np.tile(AFFINE.ravel(), (len(riders.x), 1))
    )
    assert np.abs(splats.cov[own:] - want).max() < 1e-6 * want.max()


def test_each_rides_with_its_own_object(folder):
    """Two ducks side by side behind a ball: no Gaussian is carried by the other's particles."""
    text = SCENE.replace("SOURCE", RIDING).replace("[0.32, 0.32, 0.2]", "[0.32, 0.2, 0.2]")
    head, duck = text.split("[[object]]")
    ball = duck.replace(RIDING, "shape = { sphere = { center = [0, 0, 0], radius = 0.05 } }")
    ball = ball.replace('"duck"', '"ball"').replace("0.2, 0.2]", "0.5, 0.4]")
    other = duck.replace('"duck"', '"twin"').replace("0.2, 0.2]", "0.33, 0.2]")
    both = build_scene(scene(folder, "[[object]]".join((head, ball, duck, other))))
    riders = both.passive
    assert set(riders.object) == {1, 2}
    assert np.array_equal(both.object[riders.carriers], np.repeat(riders.object[:, None], 4, 1))
    away = np.linalg.norm(both.x[riders.carriers] - riders.x[:, None], axis=2).max()
    assert away < 0.04


def test_an_uneven_motion_lies_between_its_carriers(riding):
    """Positions and shapes of one Gaussian from the formula of the page, number by number."""
    frame = moved(riding, AFFINE, np.zeros(3))
    random = np.random.default_rng(3)
    frame["F"] = frame["F"] + 0.1 * random.normal(size=frame["F"].shape)
    frame["positions"] = frame["positions"] + 0.01 * random.normal(size=frame["positions"].shape)
    splats, riders = look_of(riding).splats(frame, EYE), riding.passive
    k, own = 321, len(riding.x)
    x, F = np.zeros(3), np.zeros((3, 3))
    for i, w in zip(riders.carriers[k], riders.weights[k].astype(float)):
        Fi = frame["F"][i].reshape(3, 3)
        x += w * (frame["positions"][i] + Fi @ (riders.x[k] - riding.x[i]))
        F += w * Fi
    assert np.allclose(splats.x[own + k], x, atol=1e-12)
    (start,) = unpack_symmetric(riders.cov0[k : k + 1].astype(float))
    assert np.allclose(unpack_symmetric(splats.cov[own + k : own + k + 1])[0], F @ start @ F.T)


def test_colors_change_with_those_of_the_carriers(riding):
    """Dye that travels dyes riders by the mean of what it does to their carriers."""
    frame = moved(riding, np.eye(3), np.zeros(3))
    frame["sh"] = riding.sh + np.float32(0.2) * riding.x[:, None, :1].astype(np.float32)
    look, riders = look_of(riding), riding.passive
    part = look.parts(frame)[1]
    change = part.coefficients()[:, 0, 0] - riders.sh[:, 0, 0]
    want = 0.2 * (riders.weights * riding.x[riders.carriers, 0]).sum(axis=1)
    assert np.allclose(change, want, atol=1e-6) and np.ptp(want) > 0.01
    frame["sh"] = riding.sh
    assert np.array_equal(look.parts(frame)[1].coefficients(), riders.sh)


def test_riders_obey_the_look(riding):
    """With shapes and colors fixed they keep those at rest, and opacities are scaled by name."""
    chosen = LookSettings(covariance="fixed", rotate_sh=False, opacity_scale={"duck": 0.5})
    part = look_of(riding, chosen).parts(moved(riding, AFFINE, np.zeros(3)))[1]
    assert np.array_equal(part.cov, riding.passive.cov0)
    assert np.allclose(part.opacity, 0.5 * riding.passive.opacity) and not len(part.turning)


def test_colors_turn_along(riding):
    """A shiny Gaussian that is turned shows what it showed to an eye that is not."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    random = np.random.default_rng(4)
    riders = riding.passive
    shiny = np.zeros((len(riders.x), 4, 3), np.float32)
    shiny[:] = 0.2 * random.normal(size=shiny.shape)
    body = np.zeros((len(riding.x), 4, 3), np.float32)
    changed = SimpleNamespace(**{**vars(riding), "sh": body})
    changed.passive = type(riders)(**{**vars(riders), "sh": shiny})
    splats = look_of(changed).splats(moved(changed, quarter, np.zeros(3)), EYE)
    want = spherical_harmonics.evaluate(shiny, riders.x - quarter.T @ EYE)
    assert np.allclose(splats.color[len(riding.x) :], want, atol=1e-5)


def decibels(folder, keys):
    """Inside the outline of 12 views: with riders against unpruned; and particles of the two."""
    whole, thin = (
        made(folder, keys),
        made(folder, keys + '\nprune = "auto"\npassive_gaussians = true'),
    )
    views = image_similarity.cameras(whole.x)

    def drawn(prepared):
        frame = moved(prepared, np.eye(3), np.zeros(3))
        return [render(look_of(prepared).splats(frame, v.eye), v) for v in views]

    found = image_similarity.image_psnr(drawn(whole), drawn(thin))
    print(f"{len(whole.x)} -> {len(thin.x)} particles, inside {found.inside:.1f} dB")
    return found.inside, len(whole.x), len(thin.x)


def test_pruning_costs_no_image_quality(folder):
    inside, before, after = decibels(folder, 'mesh = "duck.obj"')
    assert inside > 60 and after < before / 5


@pytest.mark.data
@pytest.mark.skipif(not GUITAR.exists(), reason="no shared data")
def test_a_capture_loses_nothing(folder):
    keys = f'gaussians = "{GUITAR}"\nup = "-y"\nheight = 0.15'
    inside, before, after = decibels(folder, keys)
    assert inside > 60 and after < before / 5


RUN = SCENE.replace("end = 1", "end = 0.01\nframes = 2")


def test_a_run_with_riders(folder, tmp_path):
    """From the scene to a frame: a duck that flies and falls takes its Gaussians along."""
    vgmpi.run(scene(folder, RUN.replace("SOURCE", RIDING + "\nvelocity = [1, 0, 0]")), tmp_path)
    run = RunReader(tmp_path)
    riders = run.gaussians.passive
    assert {d.name for d in file_layout.PASSIVE} == set(vars(riders))
    last = run.frame(1)
    splats = Appearance(run).splats(last, EYE)
    own = len(last["id"])
    assert len(splats.x) == own + len(riders.x0)
    way = (last["positions"] - run.gaussians.x0)[0]
    assert way[0] == pytest.approx(0.01, abs=1e-6) and way[2] < -4e-4
    assert np.abs(splats.x[own:] - riders.x0 - way).max() < 1e-6
    assert "passive/weights" in inspect(tmp_path / file_layout.GAUSSIANS)


def test_what_is_off_writes_nothing(folder, tmp_path):
    thin = RIDING.replace("passive_gaussians = true", "passive_gaussians = false")
    for name, keys in (("on", RIDING), ("off", thin), ("never", 'mesh = "duck.obj"')):
        made = scene(folder, RUN.replace("SOURCE", keys))
        write_initial_particles(
            made,
            prepare(made, SerialCommunicator(), tmp_path / name),
            SerialCommunicator(),
            tmp_path / name,
        )
    groups = {}
    for name in ("on", "off", "never"):
        with h5py.File(tmp_path / name / file_layout.GAUSSIANS) as f:
            groups[name] = set(f)
    assert groups["on"] - groups["off"] == {"passive"} and groups["off"] == groups["never"]


def test_particles_without_a_frame_take_their_riders_with_them(riding):
    frame = moved(riding, np.eye(3), np.zeros(3))
    half = np.arange(0, len(riding.x), 2)
    frame = {name: array[half] for name, array in frame.items()}
    splats = look_of(riding).splats(frame, EYE)
    there = np.isin(riding.passive.carriers, half).all(axis=1)
    assert len(splats.x) == len(half) + there.sum() and 0 < there.sum() < len(there)


def test_riders_keep_their_looks(folder, riding):
    """All Gaussians of the unpruned object are drawn as they were, whoever carries mass."""
    whole = made(folder, 'mesh = "duck.obj"')
    both = np.concatenate([riding.x, riding.passive.x])
    cov = np.concatenate([riding.cov0, riding.passive.cov0])
    mine, other = np.lexsort(both.T), np.lexsort(whole.x.T)
    assert np.array_equal(both[mine], whole.x[other])
    assert np.array_equal(cov[mine], whole.cov0[other])


def test_riders_stand_in_exported_files(riding):
    """The same Gaussians as are drawn, turned colors included."""
    look, frame = look_of(riding), moved(riding, AFFINE, np.array([0.1, 0.0, 0.2]))
    want, got = look.splats(frame, EYE), export.cloud(look, frame)
    assert len(got) == len(riding.x) + len(riding.passive.x)
    np.testing.assert_allclose(got.x, want.x)
    np.testing.assert_allclose(got.cov(), want.cov, atol=1e-12)
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(got.sh, got.x - EYE), want.color, atol=1e-5
    )
