"""The page that plays a run: its bytes, its reader, and what a browser shows of it from disk."""

import dataclasses
import functools
import http.server
import io
import re
import threading

import imageio.v3 as iio
import numpy as np
import pytest

from tests.support import drawn_runs
from tests.support.headless_browser import browser_of, new_page
from tests.support.picture_noise import psnr
from vgmpi.gaussians import spherical_harmonics as harmonics
from vgmpi.gaussians.camera import look_at
from vgmpi.gaussians.cloud import pack_symmetric, rotation_matrices, unpack_symmetric
from vgmpi.gaussians.formats import motion_stream as layout
from vgmpi.gaussians.formats.motion_stream import (
    KEY_INTERVAL,
    GroupState,
    MotionGroup,
    MotionWriter,
    RestGaussians,
)
from vgmpi.gaussians.formats.residual_coding import SEGMENT, CodedRows
from vgmpi.gaussians.formats.validation import GaussianFileError
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.commands import export
from vgmpi.postprocess.export.export_moving import RunMotion
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.web import web_page

FRAMES = KEY_INTERVAL + 4  # more than one key frame
EYE, TARGET, FOV = (0.2, -1.7, 1.2), (0.5, 0.5, 0.4), 40.0
CELL = 0.1  # [m] spacing of the run's particles, which stands for its cell
SHOWN = (0, KEY_INTERVAL - 1, FRAMES - 1)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=FRAMES, k=4)


@pytest.fixture(scope="module")
def html(out, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    assert export.main([str(out), "--format", "web", "-o", str(path), "-q"]) == 0
    return path


def expected(out, index):
    """Gaussians of a frame in the order of the file."""
    look = Appearance(RunReader(out))
    motion = RunMotion(look, FRAMES // 2)
    parts = look.parts(look.frame(index))
    first = {"scenery": 0, "particles": len(parts[0].x)}
    rows = np.concatenate([first[part] + ids for part, ids in motion.members])
    x, cov = (np.concatenate([part[k] for part in parts])[rows] for k in (0, 1))
    return x, cov


def picture_of_file(reader, index, camera):
    """Picture of decoded Gaussians by the renderer."""
    frame = reader.frame(index)
    sh, opacity = reader.rest_gaussians.sh.copy(), reader.rest_gaussians.opacity * frame.present
    sh[:, 0] = harmonics.dc_from_rgb(frame.rgb)
    directions = np.einsum("nij,ni->nj", frame.rotation, frame.x - camera.eye)
    color = np.maximum(harmonics.evaluate(sh, directions), 0)
    own = np.repeat(*zip(*((g.compensated_lowpass, g.count) for g in reader.groups)))
    splats = rasterize.ProjectableGaussians(frame.x, frame.cov, opacity, color, own)
    return rasterize.render(splats, camera)[0]


@pytest.mark.parametrize("accuracy", [1e-4, 0.01])
def test_positions_hold_the_accuracy(out, tmp_path, accuracy):
    path = tmp_path / "page.html"
    argv = [str(out), "--format", "web", "-o", str(path), "-q", "--accuracy", str(accuracy)]
    assert export.main(argv) == 0
    reader = web_page.read_page(path)
    assert len(reader) == FRAMES and reader.times == pytest.approx(0.04 * np.arange(FRAMES))
    for index in (FRAMES - 1, 3, 4, KEY_INTERVAL):  # backwards too
        x, cov = expected(out, index)
        frame = reader.frame(index)
        assert frame.present.all()
        assert np.abs(frame.x - x).max() <= accuracy * CELL * (1 + 1e-6)
        largest = cov[:, (0, 3, 5)].max(axis=1)
        assert (np.abs(frame.cov - cov).max(axis=1) < 0.08 * largest).all()


@pytest.mark.parametrize("index", SHOWN)
def test_the_decoded_gaussians_give_the_renderers_picture(out, html, index):
    """45 dB is the least; reached: see docs/reference/web-format.md."""
    camera = look_at(EYE, TARGET, (0, 0, 1), FOV, 512, 512)
    look, reader = Appearance(RunReader(out)), web_page.read_page(html)
    want = rasterize.render(look.splats(look.frame(index), camera.eye), camera)[0]
    assert psnr(picture_of_file(reader, index, camera), want) > 45
    other = picture_of_file(reader, (index + FRAMES // 2) % FRAMES, camera)
    assert psnr(other, want) < 35  # the measure tells frames apart


def browser_page(play):
    browser = browser_of(play)
    return browser, new_page(browser, 512, 512)


@pytest.mark.browser
def test_a_browser_without_a_network_draws_the_renderers_pictures(out, html):
    """Three times from a camera of the renderer: 25 dB, and the integers of the Python reader."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    reader, look = web_page.read_page(html), Appearance(RunReader(out))
    camera = look_at(EYE, TARGET, (0, 0, 1), FOV, 512, 512)
    asked, errors, pictures = [], [], []
    with api.sync_playwright() as play:
        browser, page = browser_page(play)
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.context.set_offline(True)
        page.goto(html.as_uri())
        page.evaluate("() => vgmpi.ready")
        page.evaluate("() => { vgmpi.play(false); document.body.classList.add('bare'); }")
        entry = {"eye": EYE, "target": TARGET, "up": (0, 0, 1), "fov": FOV}
        page.evaluate("entry => vgmpi.look(entry)", entry)
        for index in SHOWN[::-1]:
            page.evaluate("index => vgmpi.show(index)", index)
            pictures.append(iio.imread(io.BytesIO(page.screenshot()))[..., :3] / 255)
            groups = [k for k, group in enumerate(reader.groups) if group.channels]
            for group, (_, bins) in zip(groups, reader.bins(index), strict=True):
                shown = page.evaluate("group => vgmpi.bins(group)", group)
                np.testing.assert_array_equal(shown, bins.T.ravel())
        page.keyboard.press("Home")
        page.keyboard.press("ArrowRight")
        page.wait_for_function("() => document.getElementById('time').value === '1'")
        arm = "() => vgmpi.camera.eye.map((v, k) => v - vgmpi.camera.target[k])"
        before = np.array(page.evaluate(arm))
        page.mouse.move(250, 250)
        page.mouse.down()
        page.mouse.move(300, 200, steps=4)
        page.mouse.up()
        turned = np.array(page.evaluate(arm))
        page.mouse.wheel(0, 300)
        farther = f"length => Math.hypot(...({arm})()) > length"
        page.wait_for_function(farther, arg=1.2 * float(np.linalg.norm(before)))
        seconds = page.evaluate(
            "async () => { const t = performance.now(); await vgmpi.show(11);"
            " return (performance.now() - t) / 1000; }"
        )
        browser.close()
    for index, got in zip(SHOWN[::-1], pictures):
        want = rasterize.render(look.splats(look.frame(index), camera.eye), camera)[0]
        assert psnr(got, want) > 40, index  # required: 25
        assert psnr(got, pictures[0 if index == 0 else -1]) < 35  # tells frames apart
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(before))
    assert np.linalg.norm(turned - before) > 0.2
    assert seconds < 2  # 656 Gaussians: what is slow here is the drawing without a card
    assert not errors
    assert all(url.startswith(("file:", "blob:", "data:")) for url in asked), asked


def every_kind():
    """Stream with a group of each kind: at rest, posed, of changing size, deformed, colored."""
    rng = np.random.default_rng(1)
    kinds = [
        MotionGroup("still", 40, layout.STATIC, compensated_lowpass=0.1),
        MotionGroup("wheel", 30, layout.POSED, pose=0),
        MotionGroup("water", 1100, layout.FREE, layout.SIZE, True, compensated_lowpass=0.3),
        MotionGroup("rubber", 50, layout.FREE, layout.DEFORMATION),
        MotionGroup("dust", 3 * SEGMENT, layout.FREE),
    ]
    n = sum(group.count for group in kinds)
    x = rng.uniform(0, 2, (n, 3))
    root = rng.normal(0, 0.02, (n, 6)) + 0.05 * layout.IDENTITY
    rest = RestGaussians(x, root, rng.uniform(0, 1, n), rng.normal(0, 0.2, (n, 16, 3)))
    writer = MotionWriter(kinds, rest, cell=0.1, accuracy=0.01)
    for k in range(KEY_INTERVAL + 2):
        moved = x + 0.01 * rng.normal(size=(n, 3))
        present = rng.uniform(size=1100) > 0.1 * (k > 2)
        quat = rng.normal(size=(50, 4))
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        stretch = layout.IDENTITY + 0.1 * rng.normal(size=(50, 6))
        water = moved[70:1170][present]
        # each segment of dust moves so that another prediction is the best
        dust = x[1220:].copy()
        dust[:SEGMENT] += 0.05 * k**2 * x[1220 : 1220 + SEGMENT]
        noise = 0.004 * rng.normal(size=(SEGMENT, 3))
        dust[SEGMENT : 2 * SEGMENT] += 0.05 * k * x[1220 : 1220 + SEGMENT] + noise
        dust[2 * SEGMENT :] += 0.05 * np.sin(7 * k) + 0.02 * k * x[1220 : 1220 + SEGMENT]
        m = len(water)
        states = [
            GroupState(present, water, rng.uniform(0.8, 1.2, m), color=rng.uniform(0, 1, (m, 3))),
            GroupState(np.ones(50, bool), moved[1170:1220], None, quat, stretch),
            GroupState(np.ones(len(dust), bool), dust),
        ]
        pose = np.eye(4)
        pose[:3, :3] = rotation_matrices(quat[:1])[0]  # any, half turns too
        pose[:3, 3] = rng.normal(size=3)
        writer.add_frame(0.1 * k, states, [pose])
    camera = {"eye": EYE, "target": TARGET, "up": (0, 0, 1), "fov": FOV}
    view = {"camera": camera, "background": [1, 1, 1], "alpha_min": 1 / 255, "lowpass": 0.3}
    return web_page.assemble_page(writer.to_bytes({**view, "fps": 25}), "<kinds> & \u00e4")


@pytest.mark.browser
def test_the_browser_decodes_what_python_decodes(tmp_path, monkeypatch):
    """Every kind of group: centers, shapes, colors and presence, and the picture, also from afar,
    where Gaussians are smaller than a pixel.
    """
    modes, encode = set(), CodedRows._encode_channel

    def recorded(self, *args):
        pieces = encode(self, *args)
        modes.update(pieces[0][:-1])
        return pieces

    monkeypatch.setattr(CodedRows, "_encode_channel", recorded)
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    path = tmp_path / "kinds.html"
    path.write_bytes(every_kind())
    assert {mode % 4 for mode in modes} == {0, 1, 2, 3}
    assert {mode // 4 for mode in modes} == {0, 1, 2}
    reader = web_page.read_page(path)
    with api.sync_playwright() as play:
        _, page = browser_page(play)
        page.goto(path.as_uri())
        page.evaluate("() => vgmpi.ready")
        assert page.title() == "<kinds> & \u00e4"
        page.evaluate("() => { vgmpi.play(false); document.body.classList.add('bare'); }")
        for index in (KEY_INTERVAL + 1, 5):
            page.evaluate("index => vgmpi.show(index)", index)
            arrays = {
                name: np.array(page.evaluate(f"() => Array.from(vgmpi.motion.{name})"))
                for name in ("centers", "shapes", "roots", "colors", "harmonics", "present")
            }
            frame, n = reader.frame(index), len(reader.rest_gaussians.x)
            centers, shapes = arrays["centers"].reshape(n, 4), arrays["shapes"].reshape(n, 12)
            quat = shapes[:, :4] / np.linalg.norm(shapes[:, :4], axis=1, keepdims=True)
            rotation = rotation_matrices(quat)
            M = rotation @ unpack_symmetric(shapes[:, 4:10])
            M = M @ unpack_symmetric(arrays["roots"].reshape(n, 8)[:, :6])
            M *= centers[:, 3, None, None]
            cov = pack_symmetric(M @ M.transpose(0, 2, 1))
            np.testing.assert_array_equal(arrays["present"], frame.present)
            np.testing.assert_allclose(centers[:, :3], frame.x, atol=1e-5)
            np.testing.assert_allclose(rotation, frame.rotation, atol=1e-5)
            np.testing.assert_allclose(cov, frame.cov, atol=1e-6)
            colors = arrays["colors"].reshape(n, 4)
            np.testing.assert_allclose(colors[:, :3], frame.rgb, atol=1e-5)
            np.testing.assert_allclose(colors[:, 3], reader.rest_gaussians.opacity, atol=1e-6)
            higher = arrays["harmonics"].reshape(n, 15, 4)[..., :3]
            np.testing.assert_allclose(higher, reader.rest_gaussians.sh[:, 1:], atol=1e-6)
            for eye in (EYE, (1.5, -30.0, 12.0)):
                entry = {"eye": eye, "target": TARGET, "up": (0, 0, 1), "fov": FOV}
                page.evaluate("entry => vgmpi.look(entry)", entry)
                camera = look_at(eye, TARGET, (0, 0, 1), FOV, 512, 512)
                got = iio.imread(io.BytesIO(page.screenshot()))[..., :3] / 255
                assert psnr(got, picture_of_file(reader, index, camera)) > 40


@pytest.mark.browser
def test_the_browser_draws_groups_by_their_models(tmp_path):
    """Two walls of Gaussians smaller than a pixel, one of them of antialiased training."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    kinds = [
        MotionGroup("left", 2000, layout.STATIC, compensated_lowpass=0.3),
        MotionGroup("middle", 2000, layout.STATIC, compensated_lowpass=0.1),
        MotionGroup("right", 2000, layout.STATIC),
    ]
    rng, n = np.random.default_rng(0), 6000
    x = rng.uniform(0, 1, (n, 3)) * [0.3, 0.1, 1.0] + np.repeat([[0], [1], [2]], 2000, 0) * [
        0.35,
        0,
        0,
    ]
    root = np.tile(0.0012 * layout.IDENTITY, (n, 1))  # half a pixel
    rest = RestGaussians(x, root, np.full(n, 0.9), np.full((n, 1, 3), -1.77))
    writer = MotionWriter(kinds, rest, cell=0.1, accuracy=1e-3)
    writer.add_frame(0.0, [], [])
    entry = {"eye": EYE, "target": TARGET, "up": (0, 0, 1), "fov": FOV}
    view = {"background": [1, 1, 1], "alpha_min": 1 / 255, "lowpass": 0.3, "fps": 25}
    path = tmp_path / "models.html"
    path.write_bytes(web_page.assemble_page(writer.to_bytes({**view, "camera": entry}), "models"))
    camera, reader = look_at(EYE, TARGET, (0, 0, 1), FOV, 512, 512), web_page.read_page(path)
    with api.sync_playwright() as play:
        _, page = browser_page(play)
        page.goto(path.as_uri())
        page.evaluate("() => vgmpi.ready")
        page.evaluate("() => { vgmpi.play(false); document.body.classList.add('bare'); }")
        got = iio.imread(io.BytesIO(page.screenshot()))[..., :3] / 255
    assert psnr(got, picture_of_file(reader, 0, camera)) > 38
    for k in range(2):  # the measure tells the models apart, group by group
        groups = list(reader.groups)
        reader.groups[k] = dataclasses.replace(groups[k], compensated_lowpass=0.0)
        assert psnr(got, picture_of_file(reader, 0, camera)) < 32
        reader.groups = groups


class Utf8Handler(http.server.SimpleHTTPRequestHandler):
    """Server that claims another encoding than the page's."""

    extensions_map = {".html": "text/html; charset=utf-8"}

    def log_message(self, *_):
        """Stay quiet."""


@pytest.mark.browser
def test_a_server_may_claim_another_encoding(html):
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    handler = functools.partial(Utf8Handler, directory=html.parent)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with api.sync_playwright() as play:
            browser, page = browser_page(play)
            page.goto(f"http://127.0.0.1:{server.server_port}/{html.name}")
            page.evaluate("() => vgmpi.ready")
            assert page.evaluate("() => vgmpi.motion.count") == len(
                web_page.read_page(html).rest_gaussians.x
            )
            browser.close()
    finally:
        server.shutdown()


def test_the_page_is_one_file_without_a_network(html):
    text = html.read_text("latin-1")
    assert not re.search(r"(https?:)?//[a-z]+\.", text.split('id="gaussians"')[0])
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=", text)


@pytest.mark.parametrize(
    "argv, says",
    [
        (["-o", "page.mp4"], "ends in .html"),
        (["--accuracy", "0"], "--accuracy: 0.0: allowed"),
        (["--accuracy", "nan"], "--accuracy"),
        (["--fps", "0"], "--fps"),
        (["--frames", "99"], "the run has the frames"),
        (["--up=y"], "--up: y: a moving file has z up"),
        (["--format", "ply", "--fps", "20"], "--fps: allowed with --format web"),
        (["--format", "usd", "--accuracy", "0.1"], "--accuracy: allowed with --format web"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(out, tmp_path, argv, says, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert export.main([str(out), "--format", "web", "-q", *argv]) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text


def test_a_page_without_gaussians_is_refused(html, tmp_path):
    (tmp_path / "a.html").write_text("<p>nothing</p>")
    with pytest.raises(GaussianFileError, match=r"a\.html: holds no moving Gaussians"):
        web_page.read_page(tmp_path / "a.html")
    data = html.read_bytes()
    (tmp_path / "b.html").write_bytes(data[: len(data) // 8] + data[len(data) // 7 :])
    with pytest.raises(GaussianFileError, match=r"b\.html"):
        web_page.read_page(tmp_path / "b.html")
