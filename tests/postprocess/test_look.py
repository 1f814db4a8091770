"""From rest Gaussians and moving particles to what is drawn."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.gaussians import compiled_evolution, shape_evolution, spherical_harmonics
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.io.run_reader import RunError
from vgmpi.postprocess.frames.appearance import ALPHA_MIN_FAINT, Appearance
from vgmpi.postprocess.raster.rasterize import ALPHA_MIN

EYE = np.array([0.5, -2.0, 1.0])


def fake(opacity_scale=0.5, k=1, scenery=True):
    rows, objects, ground = drawn_runs.rest_state(opacity_scale, k)
    held = SimpleNamespace(**rows, scenery=SimpleNamespace(**ground) if scenery else None)
    return SimpleNamespace(gaussians=held, objects=objects), rows


def frame(rows, k=2, frames=3):
    return {"id": np.arange(len(rows["x0"])), **drawn_runs.frame_fields(rows, k, frames)}


def test_each_family_follows_its_rule():
    run, rows = fake(scenery=False)
    f = frame(rows)
    s = Appearance(run).splats(f, EYE)
    np.testing.assert_allclose(s.x, f["positions"])
    water, bar = slice(0, drawn_runs.WATER), slice(drawn_runs.WATER, None)
    np.testing.assert_allclose(
        s.cov[water], shape_evolution.volume_sphere_covariance(rows["vol0"][water], f["J"][water])
    )
    R = drawn_runs.rotation(0.5 * np.pi)
    want = R @ unpack_symmetric(rows["cov0"][bar]) @ R.T
    np.testing.assert_allclose(unpack_symmetric(s.cov[bar]), want, atol=1e-9)
    np.testing.assert_allclose(s.opacity[water], 0.5 * 0.8, rtol=1e-6)
    np.testing.assert_allclose(s.opacity[bar], 0.8, rtol=1e-6)  # the scale is for fluids only
    np.testing.assert_allclose(s.color[water], [drawn_runs.BLUE] * drawn_runs.WATER, atol=1e-6)


@pytest.mark.parametrize("family", ["sand", "snow"])
def test_grains_are_drawn_as_balls_and_keep_their_opacity(family):
    run, rows = fake(scenery=False)
    run.objects = [dict(run.objects[0], family=family), *run.objects[1:]]
    f = frame(rows)
    s = Appearance(run).splats(f, EYE)
    water = slice(0, drawn_runs.WATER)
    np.testing.assert_allclose(
        s.cov[water], shape_evolution.volume_sphere_covariance(rows["vol0"][water], f["J"][water])
    )
    np.testing.assert_allclose(s.opacity[water], 0.8, rtol=1e-6)


def test_solids_without_a_deformation_gradient_follow_their_volume():
    """As metal does: drawn from J alone, unturned, also where a frame has no F."""
    run, rows = fake(scenery=False)
    run.objects = [run.objects[0], dict(run.objects[1], tracks_deformation=False), *run.objects[2:]]
    f = frame(rows)
    del f["F"]
    f["J"] = np.linspace(0.8, 1.2, len(f["J"]))
    s = Appearance(run).splats(f, EYE)
    bar = slice(drawn_runs.WATER, None)
    want = np.cbrt(f["J"][bar])[:, None] ** 2 * rows["cov0"][bar]
    np.testing.assert_allclose(s.cov[bar], want, rtol=1e-6)


def test_scenery_is_drawn_unmoved_in_every_frame():
    run, rows = fake()
    ground = run.gaussians.scenery
    for k in range(3):
        s = Appearance(run).splats(frame(rows, k), EYE)
        n = len(ground.x0)
        assert len(s.x) == n + len(rows["x0"])
        np.testing.assert_array_equal(s.x[:n], ground.x0)
        np.testing.assert_array_equal(s.cov[:n], ground.cov0.astype("f8"))
        np.testing.assert_allclose(s.opacity[:n], 0.9, rtol=1e-6)


def test_colors_of_solids_turn_with_them_and_those_of_others_do_not():
    run, rows = fake(k=16)
    rng = np.random.default_rng(0)
    rows["sh"][:, 1:] = 0.2 * rng.normal(size=rows["sh"][:, 1:].shape)
    f = frame(rows)
    # a stretch on top must not change the rotation
    F = f["F"].reshape(-1, 3, 3) @ np.diag([1.3, 0.9, 0.7]).astype("f4")
    s = Appearance(run).splats({**f, "F": F.reshape(-1, 9)}, EYE)
    n = len(run.gaussians.scenery.x0)
    water, bar = slice(0, drawn_runs.WATER), slice(drawn_runs.WATER, None)
    directions = f["positions"] - EYE
    R = drawn_runs.rotation(0.5 * np.pi)
    turned = spherical_harmonics.evaluate(
        spherical_harmonics.rotate(rows["sh"][bar], R), directions[bar]
    )
    np.testing.assert_allclose(s.color[n:][bar], turned, atol=1e-5)
    still = spherical_harmonics.evaluate(rows["sh"][bar], directions[bar])
    assert np.abs(turned - still).max() > 0.1
    np.testing.assert_allclose(
        s.color[n:][water],
        spherical_harmonics.evaluate(rows["sh"][water], directions[water]),
        atol=1e-5,
    )


def test_rows_are_found_by_id():
    """Frames may hold a part of the particles, as when some have not been emitted yet."""
    run, rows = fake(scenery=False)
    f = frame(rows)
    keep = np.arange(len(rows["x0"])) % 3 == 1
    part = Appearance(run).splats({name: a[keep] for name, a in f.items()}, EYE)
    whole = Appearance(run).splats(f, EYE)
    for name in ("x", "cov", "opacity", "color"):
        np.testing.assert_allclose(getattr(part, name), getattr(whole, name)[keep], atol=1e-15)


def test_frames_that_cannot_be_drawn_are_named():
    run, rows = fake()
    f = frame(rows)
    with pytest.raises(RunError, match="field F"):
        Appearance(run).splats({name: f[name] for name in ("id", "positions", "J")}, EYE)
    with pytest.raises(RunError, match="does not know"):
        Appearance(run).splats({**f, "id": f["id"] + 1}, EYE)
    run.frame = lambda index: {**f, "id": f["id"] - 1}
    with pytest.raises(RunError, match="does not know"):
        Appearance(run).frame(0)


def test_a_fluid_without_J_has_its_rest_volume():
    run, rows = fake(scenery=False)
    f = frame(rows)
    del f["J"]
    s = Appearance(run).splats(f, EYE)
    want = shape_evolution.volume_sphere_covariance(rows["vol0"], np.ones(len(rows["x0"])))
    np.testing.assert_allclose(s.cov[: drawn_runs.WATER], want[: drawn_runs.WATER])


def test_alpha_min_follows_the_fluid_and_says_so(caplog):
    caplog.set_level(logging.DEBUG, "vgmpi")
    assert Appearance(fake(0.5)[0]).alpha_min(None) == ALPHA_MIN
    assert not caplog.records
    assert Appearance(fake(0.02)[0]).alpha_min(None) == ALPHA_MIN_FAINT
    assert [r.levelname for r in caplog.records] == ["DEBUG"]
    assert "faint" in caplog.text


def test_alpha_min_of_an_object_or_of_the_settings_comes_first(caplog):
    caplog.set_level(logging.DEBUG, "vgmpi")
    run, _ = fake(0.01)
    run.objects[0]["alpha_min"] = 5e-4
    run.objects[1]["alpha_min"] = 1 / 255  # what scenes give to objects that say nothing
    assert Appearance(run).alpha_min(2e-3) == 2e-3
    assert not caplog.records
    assert Appearance(run).alpha_min(None) == 5e-4
    assert "0.0005" in caplog.text
    run.objects[0]["alpha_min"] = 1 / 255
    assert Appearance(run).alpha_min(None) == ALPHA_MIN_FAINT


def test_gaussians_that_vanish_are_warned_of_by_name(caplog):
    run, _ = fake(0.004)
    Appearance(run).alpha_min(ALPHA_MIN)
    assert [r.levelname for r in caplog.records] == ["WARNING"]
    assert "'pool'" in caplog.text and f"{drawn_runs.WATER} of {drawn_runs.WATER}" in caplog.text


@pytest.mark.parametrize("k", spherical_harmonics.COEFFICIENTS)
def test_the_compiled_colors_are_those_of_numpy(k):
    rng = np.random.default_rng(k)
    coefficients = rng.normal(size=(50, k, 3)).astype("f4")
    directions = rng.normal(size=(30, 3))
    directions[3] = 0
    rows = rng.integers(0, 50, 30)
    got = compiled_evolution.evaluate(coefficients, rows, directions)
    want = spherical_harmonics.evaluate(coefficients[rows], directions)
    np.testing.assert_allclose(got, want, atol=1e-12)
    assert (got == 0).any()


def test_the_compiled_rotations_are_those_of_numpy():
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.4 * rng.normal(size=(500, 3, 3))
    F[0], F[1], F[2], F[3] = np.zeros((3, 3)), np.diag([1.0, 1, -0.1]), np.nan, np.eye(3)
    F[4], F[5] = 1e-4 * np.eye(3), np.diag([30.0, 1.0, 0.5])
    assert (np.linalg.det(F[6:]) < 0).any()  # inverted ones are among them
    d = rng.normal(size=(500, 3))
    want = np.einsum("nij,ni->nj", shape_evolution.rotation(F), d)
    np.testing.assert_allclose(
        compiled_evolution.rotate_view_directions(F.reshape(-1, 9), d), want, atol=1e-8
    )
    single = compiled_evolution.rotate_view_directions(F.reshape(-1, 9)[6:].astype("f4"), d[6:])
    good = np.linalg.det(F[6:]) > 0.05
    np.testing.assert_allclose(single[good], want[6:][good], atol=1e-4)
