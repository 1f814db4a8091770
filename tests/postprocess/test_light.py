"""One light on all Gaussians: where shadows fall, what is turned away, and what stands on a floor.

Theory: along the light a ball's shadow on a plane is an ellipse, as wide as the ball and longer by
1 / cos of the light's angle, where the line through the ball's middle meets the plane. A pixel of
the light's picture is 2.6 mm here, the Gaussians reach 4 mm beyond their middles: 10 % of the area.
"""

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import pack_symmetric
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames.appearance import Appearance, _random
from vgmpi.postprocess.frames.render_config import LookSettings, SettingsError
from vgmpi.postprocess.raster import ground_plane, shadow_lighting
from vgmpi.postprocess.raster.rasterize import ProjectableGaussians

SHEET = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, 161),) * 2, [0.0]), -1).reshape(-1, 3)
R, HIGH = 0.1, 0.3


def balls(x, sd, color, opacity=0.95):
    """Gaussians at x (n, 3) of one standard deviation [m] and color."""
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    cov = np.tile(pack_symmetric(sd**2 * np.eye(3)[None]), (len(x), 1))
    return ProjectableGaussians(
        x, cov, np.full(len(x), opacity), np.tile(np.array(color, float), (len(x), 1))
    )


def sheet_and_ball():
    rng = np.random.default_rng(4)
    x = rng.normal(size=(25000, 3))
    x *= (R - 0.003) / np.linalg.norm(x, axis=1)[:, None]
    both = balls(np.concatenate([SHEET, x + [0.0, 0.0, HIGH]]), 0.003, (1, 1, 1))
    both.cov[len(SHEET) :] *= 0.25
    return both


@pytest.mark.parametrize("lean", [0.0, 0.5, 1.0])
def test_the_shadow_of_a_ball_is_an_ellipse(lean):
    splats = sheet_and_ball()
    sun = shadow_lighting.Light((lean, 0.0, -1.0), softness=0.0)
    reached = shadow_lighting.shadow_visibility(splats, sun)[: len(SHEET)]
    dark = SHEET[reached < 0.5]
    area = len(dark) * (1 / 160) ** 2
    assert area == pytest.approx(np.pi * R**2 * np.hypot(1, lean), rel=0.1)
    np.testing.assert_allclose(dark[:, :2].mean(axis=0), [lean * HIGH, 0.0], atol=0.01)
    assert np.ptp(dark[:, 1]) == pytest.approx(2 * R, abs=0.02)
    assert np.ptp(dark[:, 0]) == pytest.approx(2 * R * np.hypot(1, lean), abs=0.03)
    off = np.hypot((SHEET[:, 0] - lean * HIGH) / np.hypot(1, lean), SHEET[:, 1])
    assert (reached[off > 1.2 * R] == 1).mean() > 0.999  # nothing shadows itself


def test_what_is_farther_before_throws_a_softer_edge():
    splats = sheet_and_ball()
    edges = []
    for softness in (0.0, 0.2):
        reached = shadow_lighting.shadow_visibility(
            splats, shadow_lighting.Light((0.0, 0.0, -1.0), softness=softness)
        )
        edges.append(((reached > 0.1) & (reached < 0.9))[: len(SHEET)].mean())
    assert edges[1] > 2 * edges[0] > 0


def test_what_is_turned_away_is_darker():
    x = np.random.default_rng(5).uniform(-1, 1, (40000, 3))
    x = x[np.linalg.norm(x, axis=1) < 1]
    spacing = (4.19 / len(x)) ** (1 / 3)
    facing = shadow_lighting.outward_normals(x, spacing)
    r = np.linalg.norm(x, axis=1)
    outer = r > 0.95
    assert np.einsum("ij,ij->i", facing, x)[outer].mean() > 0.85
    assert np.linalg.norm(facing[r < 0.5], axis=1).mean() < 0.25
    factor = shadow_lighting.shade(
        balls(x, 0.02, (1, 1, 1)), shadow_lighting.Light((0, 0, -1.0), shadow=0, shade=0.6), spacing
    )
    top, bottom = factor[outer & (x[:, 2] > 0.9)].mean(), factor[outer & (x[:, 2] < -0.9)].mean()
    assert top > 0.95 and bottom == pytest.approx(0.4, abs=0.06)


def test_what_stands_on_the_floor_darkens_it_and_what_is_high_above_does_not():
    camera = look_at((0.0, 0.0, 4.0), (0, 0, 0), (0, 1, 0), 40, 101, 101)
    under = ground_plane.GroundPlane(color=(1, 1, 1), shadow=0.0, contact=0.5)
    seen = []
    for height in (0.0, 1.0):
        splats = balls(SHEET[::3] * [0.5, 0.5, 0] + [0, 0, 0.01 + height], 0.01, (1, 1, 1))
        shadow = ground_plane.cast_shadow(splats, under)
        seen.append(
            ground_plane.composite_ground(
                under, shadow, camera, (1, 1, 1), ground_plane.contact_shadow(splats, under)
            )
        )
    assert seen[0][50, 50] == pytest.approx(0.5, abs=0.05) and seen[1][50, 50] == pytest.approx(1)
    assert seen[0][0, 0] == pytest.approx(1)


def test_grain_is_of_a_particle_whatever_the_frame(tmp_path):
    run = RunReader(drawn_runs.write(tmp_path, frames=3))
    assert abs(_random(np.arange(10000)).mean()) < 0.03
    assert np.abs(_random(np.arange(10000))).max() <= 1
    plain, eye = Appearance(run, LookSettings(color_transfer="off")), np.array([0.5, -2.0, 0.5])
    grainy = Appearance(run, LookSettings(color_transfer="off", brightness_jitter={"bar": 0.3}))
    factors = []
    for k in range(3):
        frame = plain.frame(k)
        both = [np.asarray(look.splats(frame, eye).color) for look in (plain, grainy)]
        factors.append(both[1].sum(axis=1) / both[0].sum(axis=1))
    fewer = {name: a[10:] if len(a) == len(frame["id"]) else a for name, a in frame.items()}
    some = np.asarray(grainy.splats(fewer, eye).color)[len(run.gaussians.scenery.x0) :]
    np.testing.assert_array_equal(some[drawn_runs.WATER - 10 :], both[1][-drawn_runs.BAR :])
    scenery = len(run.gaussians.scenery.x0)
    np.testing.assert_allclose(factors[0], factors[2], rtol=1e-6)
    assert (factors[0][: scenery + drawn_runs.WATER] == 1).all()
    bar = factors[0][scenery + drawn_runs.WATER :]
    assert 0.1 < bar.std() < 0.25 and bar.min() >= 0.7 and bar.max() <= 1.3
    with pytest.raises(
        SettingsError, match="look.brightness_jitter: there is no object 'bra' .did you mean 'bar'"
    ):
        Appearance(run, LookSettings(brightness_jitter={"bra": 0.3}))
