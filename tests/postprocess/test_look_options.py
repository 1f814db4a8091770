"""The table [look] of render.toml: the same run drawn in other ways."""

import numpy as np
import pytest

from tests.postprocess.test_look import EYE, fake, frame
from tests.support import drawn_runs
from vgmpi.gaussians import shape_evolution, spherical_harmonics
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.render_config import LookSettings, SettingsError

WATER, BAR = slice(0, drawn_runs.WATER), slice(drawn_runs.WATER, None)


def drawn(deforms=None, k=1, **chosen):
    """Splats of frame 2, its fields, the state at rest. deforms: whether the water carries F."""
    run, rows = fake(scenery=False, k=k)
    rng = np.random.default_rng(0)
    rows["sh"][:, 1:] = 0.2 * rng.normal(size=rows["sh"][:, 1:].shape)
    rows["cov0"][WATER] = drawn_runs.diagonal(4e-4, 1e-4, 2.5e-5, drawn_runs.WATER)
    if deforms is not None:
        run.objects[0]["tracks_deformation"] = deforms
    f = frame(rows)
    f["F"][WATER] = (np.diag([1.2, 1.0, 0.9]) @ drawn_runs.rotation(0.3)).ravel()
    return Appearance(run, LookSettings(**chosen)).splats(f, EYE), f, rows


def test_fixed_shapes_are_those_at_rest():
    s, _, rows = drawn(covariance="fixed")
    np.testing.assert_array_equal(s.cov, rows["cov0"].astype("f8"))


def test_fixed_shapes_and_harmonics_need_no_deformation():
    run, rows = fake(scenery=False, k=4)
    rows["sh"][:, 1:] = 0.2
    f = frame(rows)
    del f["F"]
    chosen = LookSettings(covariance="fixed", rotate_sh=False)
    assert len(Appearance(run, chosen).splats(f, EYE).x) == len(f["positions"])


@pytest.mark.parametrize("covariance", ["evolve", "fixed"])
def test_fixed_harmonics_do_not_turn(covariance):
    s, f, rows = drawn(k=16, rotate_sh=False, covariance=covariance)
    want = spherical_harmonics.evaluate(rows["sh"], f["positions"] - EYE)
    np.testing.assert_allclose(s.color, want, atol=1e-5)
    turned, _, _ = drawn(k=16, covariance=covariance)
    assert np.abs(turned.color[BAR] - want[BAR]).max() > 0.05


def test_fixed_opacities_are_as_captured():
    s, _, _ = drawn(opacity="fixed")
    np.testing.assert_allclose(s.opacity, 0.8, rtol=1e-6)


def test_balls_by_volume_by_radius_or_by_deformation():
    usual, f, rows = drawn()
    by_volume, _, _ = drawn(covariance_normalization="volume")
    np.testing.assert_array_equal(by_volume.cov, usual.cov)
    want = shape_evolution.volume_sphere_covariance(rows["vol0"], f["J"])[WATER]
    np.testing.assert_allclose(by_volume.cov[WATER], want)

    by_radius, _, _ = drawn(covariance_normalization="radius")
    r2 = (4e-4 * 1e-4 * 2.5e-5) ** (1 / 3)
    want = np.cbrt(f["J"][WATER]) ** 2 * r2
    np.testing.assert_allclose(by_radius.cov[WATER][:, (0, 3, 5)], want[:, None] * [1, 1, 1], 1e-6)
    assert not by_radius.cov[WATER][:, (1, 2, 4)].any()

    swollen, _, _ = drawn(covariance_normalization="none")
    want = np.cbrt(f["J"])[:, None] ** 2 * rows["cov0"]
    np.testing.assert_allclose(swollen.cov[WATER], want[WATER], rtol=1e-5)

    for s in (by_volume, by_radius, swollen):  # solids follow F whatever is said of balls
        np.testing.assert_array_equal(s.cov[BAR], usual.cov[BAR])


def test_fluids_that_carry_a_deformation_gradient_follow_it():
    for chosen in ({}, {"covariance_normalization": "none"}):
        s, f, rows = drawn(deforms=True, k=4, **chosen)
        F = f["F"][WATER].reshape(-1, 3, 3)
        want = F @ unpack_symmetric(rows["cov0"][WATER]) @ F.transpose(0, 2, 1)
        np.testing.assert_allclose(unpack_symmetric(s.cov[WATER]), want, rtol=0, atol=1e-9)
        turned = spherical_harmonics.rotate(rows["sh"][WATER], shape_evolution.rotation(F))
        want = spherical_harmonics.evaluate(turned, f["positions"][WATER] - EYE)
        np.testing.assert_allclose(s.color[WATER], want, atol=1e-5)
    s, f, rows = drawn(deforms=True, k=4, covariance_normalization="volume")
    np.testing.assert_allclose(
        s.cov[WATER], shape_evolution.volume_sphere_covariance(rows["vol0"], f["J"])[WATER]
    )
    want = spherical_harmonics.evaluate(rows["sh"][WATER], f["positions"][WATER] - EYE)
    np.testing.assert_allclose(s.color[WATER], want, atol=1e-5)


def test_opacity_scales_are_said_anew_for_any_object():
    s, _, _ = drawn(opacity_scale={"pool": 0.1})
    np.testing.assert_allclose(s.opacity[WATER], 0.08, rtol=1e-6)
    np.testing.assert_allclose(s.opacity[BAR], 0.8, rtol=1e-6)
    s, _, _ = drawn(opacity_scale={"bar": 0.5})
    np.testing.assert_allclose(s.opacity[WATER], 0.4, rtol=1e-6)
    np.testing.assert_allclose(s.opacity[BAR], 0.4, rtol=1e-6)
    run, rows = fake()
    look = Appearance(run, LookSettings(opacity_scale={"floor": 0.5}))
    np.testing.assert_allclose(look.splats(frame(rows), EYE).opacity[0], 0.45, rtol=1e-6)


def test_an_unknown_object_is_named():
    said = r"look.opacity_scale: there is no object 'pol' \(did you mean 'pool'\?\); known: pool"
    with pytest.raises(SettingsError, match=said):
        drawn(opacity_scale={"pol": 0.5})


def test_alpha_min_follows_the_opacities_that_are_drawn():
    run, _ = fake(0.5)
    faint = Appearance(run, LookSettings(opacity_scale={"pool": 0.01}))
    assert faint.alpha_min(None) == 1e-4
    run, _ = fake(0.01)
    run.objects[0]["alpha_min"] = 1 / 255
    assert Appearance(run, LookSettings(opacity="fixed")).alpha_min(None) == pytest.approx(1 / 255)


@pytest.mark.parametrize("opacity, count", [(0.0, 0), (0.001, 1)])
def test_gaussians_that_are_too_faint_are_told_and_those_of_mass_alone_are_not(
    opacity, count, caplog
):
    run, rows = fake()
    rows["opacity"][BAR] = opacity
    with caplog.at_level("WARNING", "vgmpi"):
        Appearance(run, LookSettings()).alpha_min(None)
    assert len(["vanish" in record.getMessage() for record in caplog.records]) == count
