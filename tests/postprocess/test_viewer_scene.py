"""Pages of viser for scenes of all sizes: what is sent, where the cameras are, what is saved."""

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.gaussians.camera import look_at
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.frame_renderer import visible_extent
from vgmpi.postprocess.live import guarded_server, viewer_scene
from vgmpi.postprocess.live.followed_run import FollowedRun, GaussianSelection
from vgmpi.postprocess.live.live_page import LivePage, PageOptions
from vgmpi.postprocess.live.saved_camera import save_camera, view_of_camera

viser = pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[live]"')

CELLS = [1e-6, 5e-4, 1.0, 1e3]  # [m]
HALF_PRECISION = 2.0**-11  # relative rounding error
BAR_COVARIANCE = np.array([0.02, 0.01, 0.04]) ** 2 * drawn_runs.CELLS**2  # [cells2] of the red bar


def sent_gaussians(handle):
    """Centers (n, 3) and covariances (n, 6) in the bytes that viser sends.

    Its shader reads three floats, a number of its own, six halves and a color.
    """
    return handle.buffer[:, :3].view(np.float32), handle.buffer[:, 4:7].view(np.float16)


def check_bar(handle, count):
    """Check the Gaussians of the bar, which lie behind those of the water."""
    centers, cov = (part[-drawn_runs.BAR :].astype(float) for part in sent_gaussians(handle))
    np.testing.assert_allclose(
        cov[:, (0, 3, 5)], np.tile(BAR_COVARIANCE, (len(cov), 1)), rtol=1.01 * HALF_PRECISION
    )
    assert len(handle.buffer) == count and (cov[:, (1, 2, 4)] == 0).all()
    x = drawn_runs.rest_state()[0]["x0"][-drawn_runs.BAR :] * drawn_runs.CELLS
    np.testing.assert_allclose(centers, x, rtol=1e-5)


@pytest.fixture
def live_page(tmp_path):
    """Function that makes the live page of a run, with viewers that are not there."""
    servers = []

    def make(out, name="page"):
        chosen = render_config.load(None)
        sock = guarded_server.open_socket("127.0.0.1", 0)
        rules = guarded_server.AccessRules(None, sock.getsockname()[1])
        servers.append(guarded_server.start_server("127.0.0.1", rules, sock, name))
        options = PageOptions(None, tmp_path / "render.toml", None)
        return LivePage(servers[-1], FollowedRun(out, 10**6, chosen.look), chosen, options)

    yield make
    for server in servers:
        guarded_server.stop_server(server)


@pytest.mark.parametrize("cell", CELLS)
def test_the_live_page_sends_cells(tmp_path, live_page, cell):
    out = drawn_runs.write(tmp_path / "out", frames=1, cell=cell)
    page = live_page(out)
    page._update()
    page._send_frame(page.followed.read_frame(0, page._eye, None), "as drawn")
    check_bar(page._nodes["/particles"], drawn_runs.WATER + drawn_runs.BAR)
    assert np.isfinite(sent_gaussians(page._nodes["/scenery"])[1]).all()
    initial = page.server.initial_camera
    np.testing.assert_allclose(initial.position, page._camera.eye / cell, rtol=1e-6)
    low, high = visible_extent(RunReader(out))
    np.testing.assert_allclose(initial.look_at, 0.5 * (low + high) / cell, rtol=1e-5)
    check_planes(initial.position, (initial.near, initial.far))


def check_planes(position, planes, cells=drawn_runs.CELLS):
    """Check that all corners of the domain and the eye's surroundings are between the planes."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T * cells
    distances = np.linalg.norm(corners - position, axis=1)
    assert planes[0] < 0.01 * distances.min() and planes[1] > 10 * distances.max()
    assert planes[1] < 1e7 * planes[0]  # as 24 bits of depth can tell


@pytest.mark.parametrize("cell", CELLS)
def test_a_saved_camera_is_in_meters(tmp_path, cell):
    camera = SimpleNamespace(
        position=np.array([8.0, -3.0, 2.0]), look_at=np.array([2.0, 2.5, 1.0]),
        up_direction=np.array([0.0, 0.0, 1.0]), fov=0.7, aspect=1.5,
    )  # fmt: skip
    save_camera(tmp_path / "render.toml", view_of_camera(camera, cell))
    saved = tomllib.loads((tmp_path / "render.toml").read_text())["camera"]
    np.testing.assert_allclose(saved["eye"], camera.position * cell, rtol=1e-5)
    np.testing.assert_allclose(saved["target"], camera.look_at * cell, rtol=1e-5)
    assert saved["up"] == [0.0, 0.0, 1.0] and saved["fov"] == pytest.approx(40.107)


def test_colors_are_seen_from_the_viewer_in_meters(tmp_path, live_page, monkeypatch):
    page = live_page(drawn_runs.write(tmp_path / "out", frames=1, cell=2e-4))
    page._update()
    viewer = SimpleNamespace(camera=SimpleNamespace(position=(10.0, -20.0, 5.0)))
    monkeypatch.setattr(page.server, "get_clients", lambda: {0: viewer})
    eyes, read = [], page.followed.read_frame
    monkeypatch.setattr(
        page.followed, "read_frame", lambda n, eye, f: eyes.append(eye) or read(n, eye, f)
    )
    page._show_frame()
    np.testing.assert_allclose(eyes, [[2e-3, -4e-3, 1e-3]])


def test_a_run_with_other_cells_in_its_place_begins_a_scene(tmp_path, live_page):
    page = live_page(drawn_runs.write(tmp_path / "out", frames=1, cell=2e-4))
    page._update()
    before = page.server.initial_camera.position
    drawn_runs.write(tmp_path / "out", frames=2, cell=1e3)  # unseen between two looks
    page._update()
    np.testing.assert_allclose(page.server.initial_camera.position, before, rtol=1e-4)
    assert page._camera.eye[0] == pytest.approx(1e3 * before[0], rel=1e-4)


def test_gaussians_beyond_half_precision_stay_finite():
    """A Gaussian of 1000 cells is shown with 256; its shape stays."""
    cov = np.array([[1.0, 0.5, 0.0, 2.0, 0.0, 1e-3]]) * 1e6
    arrays = viewer_scene.splat_arrays(
        np.zeros((1, 3)), cov * 1e-4, np.ones((1, 3)), np.ones(1), cell=1e-2
    )
    shown = arrays["covariances"].astype(np.float16)[0].astype(float)
    assert shown.max() == 65504.0
    ratio = np.array([[0.5, 0.25, 0.0], [0.25, 1.0, 0.0], [0.0, 0.0, 5e-4]])
    np.testing.assert_allclose(shown / shown.max(), ratio, rtol=2 * HALF_PRECISION, atol=1e-9)


def test_a_scene_without_cells_takes_the_distance_of_particles(tmp_path):
    look = Appearance(RunReader(drawn_runs.write(tmp_path / "out", frames=1)))
    assert GaussianSelection(look, 10).cell == look.cell_size() == pytest.approx(0.1)


@pytest.mark.parametrize("cells", [5, 100, 4000])
def test_clipping_planes_enclose_domains_of_any_number_of_cells(cells):
    """viser's own far plane is at 1000."""
    box = np.zeros(3), np.full(3, 0.01 * cells)
    eye = np.array([-1.5, -1.0, 1.0]) * box[1]
    view = look_at(eye, 0.5 * box[1], (0, 0, 1), 40.0, 100, 100)
    camera = viewer_scene.viewer_camera(view, box, 0.01)
    np.testing.assert_allclose(camera.look_at, [cells / 2] * 3)
    check_planes(camera.position, (camera.near_plane, camera.far_plane), cells)


@pytest.mark.parametrize("size", [1e-5, 1.0, 2e4])
def test_a_point_behind_a_camera_is_turned_about_in_front_of_it(size):
    """At the same place of scenes of 10 um and 20 km."""
    camera = look_at(np.array([0.0, -size, 0.0]), np.zeros(3), (0, 0, 1), 40.0, 100, 100)
    np.testing.assert_allclose(camera.axis_point(np.zeros(3)), np.zeros(3), atol=1e-9 * size)
    behind = camera.axis_point(np.array([0.0, -3 * size, 0.0]))
    np.testing.assert_allclose(behind, [0.0, -0.998 * size, 0.0], atol=1e-9 * size)
