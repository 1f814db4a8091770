"""Pitch and field of view from vanishing lines: against the cameras that drew the lines."""

import logging
import time
import tomllib

import numpy as np
import pytest
from PIL import Image

from tests.support import drawn_photograph, drawn_room
from vgmpi.tools.photo import camera_guess, example_photographs, layout_config, photograph
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.manhattan_frame import Segments, _sines, detect_segments, fit_frame
from vgmpi.tools.photo.photo_camera import View

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
CAMERAS = [  # pitch, field of view, yaw of the room [degrees]
    (5.0, 60.0, 25.0),
    (9.0, 45.0, -38.0),
    (14.0, 70.0, 4.0),
    (18.0, 52.0, -15.0),
    (22.0, 35.0, 33.0),
    (28.0, 65.0, -43.0),
    (35.0, 40.0, 10.0),
]
LENSES = {"bent": {"bend": 0.03}, "off": {"offset": 0.008}, "turned": {"roll": 1.5}}
LAYOUT = '[[object]]\nname = "box"\nbox = [0, 0, 9, 9]\nheight = "20 cm"\n'


def view_of(pitch, fov):
    return View(480, 360, fov, pitch)


def errors(frame, view):
    """Differences of pitch [degrees] and of the focal length [-] to a camera, and intervals."""
    pitch, focal = np.degrees(frame.pitch) - view.pitch, np.log(frame.focal / view.focal)
    return (pitch, np.degrees(frame.pitch_interval)), (focal, frame.focal_interval)


def fov_of(frame, height):
    return np.degrees(2 * np.arctan(0.5 * height / frame.focal))


@pytest.mark.parametrize("pitch, fov, yaw", CAMERAS)
def test_a_room_has_the_camera_that_drew_it(pitch, fov, yaw):
    view = view_of(pitch, fov)
    segments = detect_segments(drawn_room.draw(view, yaw))
    both, alone = (fit_frame(segments, view.height, known) for known in (None, fov))
    assert both is not None and alone is not None
    (error, interval), (focal_error, focal_interval) = errors(both, view)
    print(
        f"| {pitch:g} | {fov:g} | {yaw:g} | {np.degrees(both.pitch):.1f} +- {interval:.1f} "
        f"| {fov_of(both, view.height):.1f} +- "
        f"{np.degrees(np.sin(np.radians(fov)) * focal_interval):.1f} "
        f"| {np.degrees(alone.pitch):.1f} | {100 * both.share:.0f} % |"
    )
    assert abs(error) < min(1.5, interval) and abs(focal_error) < focal_interval
    assert fov_of(both, view.height) == pytest.approx(fov, rel=0.1)
    assert np.degrees(alone.pitch) == pytest.approx(pitch, abs=1.5)
    assert abs(errors(alone, view)[0][0]) < errors(alone, view)[0][1]
    assert alone.focal == pytest.approx(view.focal, rel=1e-12) and alone.focal_interval == 0
    assert abs(np.degrees(both.roll)) < 1 and both.share > 0.7


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("pitch, fov, yaw", CAMERAS[1::2])
def test_intervals_cover_what_lenses_and_hands_do(lens, pitch, fov, yaw):
    view = view_of(pitch, fov)
    segments = detect_segments(drawn_room.draw(view, yaw, **LENSES[lens]))
    claims = [fit_frame(segments, view.height, known) for known in (None, fov)]
    assert claims[1] is not None
    for frame in filter(None, claims):
        (error, interval), (focal_error, focal_interval) = errors(frame, view)
        print(f"{lens}: {error:+.2f} +- {interval:.2f} degrees, {focal_error:+.3f}")
        assert abs(error) < min(1.5, interval) and abs(focal_error) <= focal_interval + 1e-9


def test_trial_steps_of_the_fit_do_not_overflow():
    """A fit of poor lines may try any focal length."""
    one = Segments(np.array([[10.0, 5.0]]), np.array([[1.0, 0.0]]), np.array([20.0]))
    with np.errstate(over="raise", invalid="raise"):
        sines = _sines(np.array([[0.1, 0.0, 0.3, 1000.0]]), one)
    assert np.isfinite(sines).all()


def test_the_roll_is_told():
    view = view_of(20.0, 50.0)
    frame = fit_frame(detect_segments(drawn_room.draw(view, 30.0, roll=6.0)), view.height, None)
    assert abs(np.degrees(frame.roll)) == pytest.approx(6, abs=0.5)
    assert np.degrees(frame.pitch) == pytest.approx(20, abs=1.5)


def test_a_known_pitch_stays_and_tells_the_field_of_view():
    view = view_of(18.0, 52.0)
    segments = detect_segments(drawn_room.draw(view, -15.0))
    frame = fit_frame(segments, view.height, None, 18.0)
    assert np.degrees(frame.pitch) == pytest.approx(18, abs=1e-9) and frame.pitch_interval == 0
    assert frame.focal == pytest.approx(view.focal, rel=0.04)
    assert fit_frame(segments, view.height, None, 60.0) is None, "lines contradict that pitch"


def test_one_direction_on_the_floor_suffices_with_a_known_field_of_view():
    view = view_of(18.0, 52.0)
    segments = detect_segments(drawn_room.draw(view, 25.0))
    point = view.pixels(drawn_room.turn(25.0)[:, 1])[0] - (view.width / 2, view.height / 2)
    way = point - segments.middle
    sine = (segments.along * way[:, ::-1] * (1, -1)).sum(axis=1) / np.hypot(*way.T)
    rails = segments.select(np.abs(sine) < np.sin(np.radians(2.0)))
    assert 8 <= len(rails.length) < len(segments.length) / 2
    frame = fit_frame(rails, view.height, 52.0)
    assert np.degrees(frame.pitch) == pytest.approx(18, abs=1.5)
    assert fit_frame(rails, view.height, None) is None, "one vanishing point, two unknowns"


def edges(view, yaw, counts, seed=1):
    """Segments of edges in space along the axes of a room, as many as `counts` of each."""
    random = np.random.default_rng(seed)
    axis = np.eye(3)[np.repeat([0, 1, 2], counts)] @ drawn_room.turn(yaw).T
    middle = view.rays(random.uniform((0, 0), (view.width, view.height), (len(axis), 2)))
    middle *= random.uniform(2, 4, (len(axis), 1))
    ends = np.stack([view.pixels(middle + side * axis)[0] for side in (-0.2, 0.2)], axis=1)
    ends += random.normal(0, 0.3, ends.shape) - (view.width / 2, view.height / 2)
    step = ends[:, 1] - ends[:, 0]
    length = np.hypot(*step.T)
    segments = Segments(ends.mean(axis=1), step / length[:, None], length)
    return segments.select(np.argsort(-length))


@pytest.mark.parametrize("counts", [(0, 0, 12), (12, 0, 12), (10, 10, 10)])
def test_a_second_reading_of_the_same_lines_leaves_the_pitch_open(counts):
    """Upright edges above the eye converge like level ones on a floor seen from far above."""
    view = view_of(-20.0, 50.0)
    assert fit_frame(edges(view, 0.0, counts), view.height, 50.0) is None


@pytest.mark.parametrize("pitch, yaw", [(-20.0, 40.0), (20.0, 0.0)])
def test_lines_with_one_reading_tell_the_pitch(pitch, yaw):
    view = view_of(pitch, 50.0)
    frame = fit_frame(edges(view, yaw, (10, 10, 10)), view.height, 50.0)
    assert np.degrees(frame.pitch) == pytest.approx(pitch, abs=1)


def test_lines_of_two_cameras_tell_neither():
    views = view_of(8.0, 50.0), view_of(40.0, 50.0)
    parts = [edges(view, 30.0, (n, n, n)) for view, n in zip(views, (20, 14))]
    assert all(fit_frame(part, 360, 50.0) is not None for part in parts)
    both = Segments(*(np.concatenate(arrays) for arrays in zip(*parts)))
    assert fit_frame(both.select(np.argsort(-both.length)), 360, 50.0) is None


def test_four_of_eight_lines_that_meet_are_chance():
    view = view_of(20.0, 50.0)
    for seed in range(20):
        random = np.random.default_rng(seed)
        turn, length = random.uniform(0, np.pi, 4), random.uniform(20, 40, 4)
        stray = Segments(
            random.uniform((-220, -160), (220, 160), (4, 2)),
            np.stack([np.cos(turn), np.sin(turn)], axis=-1), length,
        )  # fmt: skip
        parts = edges(view, 30.0, (0, 4, 0), seed), stray
        both = Segments(*(np.concatenate(arrays) for arrays in zip(*parts)))
        assert fit_frame(both.select(np.argsort(-both.length)), 360, 50.0) is None


def plain_ball():
    y, x = np.mgrid[0:360, 0:480]
    off = np.hypot(x - 250, y - 190) / 90
    rgb = np.full((360, 480, 3), 190.0)
    rgb[off < 1] = (200, 60, 50) * np.sqrt(np.maximum(1 - off[off < 1] ** 2, 0.05))[:, None]
    noise = np.random.default_rng(2).normal(0, 3, rgb.shape)
    return np.clip(rgb + noise, 0, 255).astype(np.uint8)


def ball_on_a_table():
    drawing = drawn_photograph.drawing
    return drawing.draw([drawn_photograph.THINGS[0]], drawn_photograph.VIEW, 0.28).rgb


def noise(blur):
    from scipy import ndimage

    rgb = np.random.default_rng(4).normal(0, 1, (480, 640))
    rgb = ndimage.gaussian_filter(rgb, blur) if blur else rgb
    grey = np.clip(128 + 50 * rgb / rgb.std(), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(grey[..., None].repeat(3, axis=-1))


def strokes(width=640, height=480, count=60):
    """Lines at random, which nothing makes converge."""
    from PIL import ImageDraw

    random = np.random.default_rng(6)
    image = Image.new("RGB", (width, height), (180, 180, 180))
    pen = ImageDraw.Draw(image)
    for _ in range(count):
        x, y, turn = random.uniform(0, (width, height, np.pi))
        step = 50 * np.cos(turn), 50 * np.sin(turn)
        pen.line([x - step[0], y - step[1], x + step[0], y + step[1]], fill=(40, 40, 60), width=3)
    return np.asarray(image)


@pytest.mark.parametrize(
    "make",
    [plain_ball, ball_on_a_table, lambda: noise(0), lambda: noise(2.5), strokes],
    ids=["ball", "ball on a table", "noise", "blurred noise", "strokes"],
)
def test_a_picture_without_such_lines_tells_nothing(make):
    rgb = make()
    segments = detect_segments(rgb)
    print(f"{len(segments.length)} segments")
    for fov in (None, 30.0, 50.0):
        assert fit_frame(segments, rgb.shape[0], fov) is None


@pytest.mark.parametrize("name", example_photographs.SUMMARIES)
def test_the_examples_keep_their_cameras_and_no_line_contradicts(name, tmp_path):
    """What would be found if a layout gave no camera, beside what it gives."""
    if name in ("coffee", "chelsea", "rocket"):
        pytest.importorskip("skimage.data", reason="scikit-image has the photograph")
    photo_path, layout_path = example_photographs.write_example(name, tmp_path)
    photo = photograph.read(photo_path)
    loaded = layout_config.read(layout_path)
    guesses: list = []
    view = camera_guess.guess_view(loaded, photo, [], guesses)
    camera = loaded.layout.camera
    assert (view.fov, view.pitch) == (camera.fov, camera.pitch) and guesses == []
    segments = detect_segments(photo.rgb)
    for fov in (None, camera.fov):
        frame = fit_frame(segments, view.height, fov)
        print(f"{name}: pitch {camera.pitch:g}, fov {camera.fov:g}; {frame}")
        assert frame is None


@pytest.mark.parametrize("name", ["astronaut", "camera", "brick", "grass", "gravel", "coins"])
def test_other_photographs_tell_nothing(name):
    data = pytest.importorskip("skimage.data", reason="scikit-image has the photograph")
    rgb = np.asarray(Image.fromarray(getattr(data, name)()).convert("RGB"))
    segments = detect_segments(np.ascontiguousarray(rgb))
    for fov in (None, 45.0):
        assert fit_frame(segments, rgb.shape[0], fov) is None


def test_a_photograph_with_a_calibrated_camera():
    """The motorcycle in a garage (Scharstein et al. 2014): lines beside it tell the focal length
    of the calibration. Its axis passes 59 pixels beside the middle."""
    data = pytest.importorskip("skimage.data", reason="scikit-image has the photograph")
    rgb = np.ascontiguousarray(data.stereo_motorcycle()[0][..., :3])
    mask = np.zeros(rgb.shape[:2], bool)
    mask[150:450, 110:690] = True
    segments = detect_segments(rgb)
    segments = segments.select(camera_guess._beside_objects(segments, [mask]))
    frame = fit_frame(segments, rgb.shape[0], None)
    print(f"{frame.focal:.0f} pixels +- {100 * frame.focal_interval:.0f} %, true: 995; {frame}")
    assert frame.focal == pytest.approx(994.978, rel=min(0.1, frame.focal_interval))
    known = fit_frame(segments, rgb.shape[0], float(np.degrees(2 * np.arctan(250 / 994.978))))
    assert known.pitch == pytest.approx(frame.pitch, abs=frame.pitch_interval)


def test_the_camera_has_the_same_bits_each_time():
    view = view_of(18.0, 52.0)
    rgb = drawn_room.draw(view, -15.0)
    first, second = (fit_frame(detect_segments(rgb), view.height, None) for _ in range(2))
    assert first is not None and first == second


def test_a_photograph_with_many_lines_takes_less_than_two_seconds(tmp_path):
    rgb = strokes(1280, 960, 600)
    Image.fromarray(rgb).save(tmp_path / "photo.png")
    photo = photograph.read(tmp_path / "photo.png")
    mask = np.zeros(rgb.shape[:2], bool)
    mask[:300, :300] = True
    start = time.process_time()
    assert camera_guess._vanishing_frame(photo, [mask], None, None) is None
    seconds = time.process_time() - start
    print(f"{len(detect_segments(rgb).length)} segments, {seconds:.2f} s of processor time")
    assert seconds < 2


@pytest.fixture
def room(tmp_path):
    """A photograph of the room, and a function from a layout's text to its guess and its log."""
    path = tmp_path / "photo.png"
    Image.fromarray(drawn_room.draw(view_of(18.0, 52.0), -15.0)).save(path)

    def guess(text, caplog, photo_path=path):
        layout = tmp_path / "layout.toml"
        layout.write_text(text)
        caplog.clear()
        photo, guesses = photograph.read(photo_path), []
        mask = np.zeros(photo.rgb.shape[:2], bool)
        with caplog.at_level(logging.INFO, logger="vgmpi.tools.photo"):
            view = camera_guess.guess_view(layout_config.read(layout), photo, [mask], guesses)
        return view, {path[1]: reason for path, _, reason in guesses}, caplog.messages

    return guess


def test_the_line_has_interval_and_reason(room, caplog):
    view, reasons, lines = room(LAYOUT, caplog)
    assert view.pitch == pytest.approx(18, abs=1.5) and view.fov == pytest.approx(52, rel=0.1)
    (line,) = lines
    assert line.startswith(f"camera: pitch {view.pitch:g} +- 1") and f"fov {view.fov:g} +-" in line
    assert line.endswith("% of their length agrees") and "vanishing lines" in line
    assert all("+-" in reason and "vanishing lines" in reason for reason in reasons.values())


def test_what_the_layout_gives_wins(room, caplog):
    text = "[camera]\nfov = 33\npitch = -4\n" + LAYOUT
    assert room(text, caplog) == (View(480, 360, 33.0, -4.0), {}, [])
    view, reasons, lines = room("[camera]\nfov = 52\n" + LAYOUT, caplog)
    assert view.fov == 52 and view.pitch == pytest.approx(18, abs=1.5)
    assert set(reasons) == {"pitch"} and "fov" not in lines[0]
    view, reasons, lines = room("[camera]\npitch = 18\n" + LAYOUT, caplog)
    assert view.pitch == 18 and view.fov == pytest.approx(52, rel=0.1)
    assert set(reasons) == {"fov"} and "pitch" not in lines[0]


def test_exif_tells_the_field_of_view_and_lines_the_pitch(room, caplog, tmp_path):
    view = view_of(18.0, 52.0)
    exif = Image.Exif()
    focal_35 = 43.2666 * view.focal / np.hypot(view.width, view.height)
    exif.get_ifd(0x8769)[0xA405] = round(focal_35)
    path = tmp_path / "exif.jpg"
    Image.fromarray(drawn_room.draw(view, -15.0)).save(path, exif=exif, quality=90)
    guess, reasons, lines = room(LAYOUT, caplog, path)
    assert "EXIF" in reasons["fov"] and guess.fov == pytest.approx(52, rel=0.03)
    assert guess.pitch == pytest.approx(18, abs=1.5) and "vanishing" in reasons["pitch"]
    assert len(lines) == 2


def test_a_turned_photograph_is_one_more_line(room, caplog, tmp_path):
    path = tmp_path / "turned.png"
    Image.fromarray(drawn_room.draw(view_of(18.0, 52.0), -15.0, roll=5.0)).save(path)
    _, _, lines = room(LAYOUT, caplog, path)
    assert len(lines) == 2 and "turned by 5." in lines[1] or "turned by 4." in lines[1]


def test_without_lines_the_defaults_stay(room, caplog, tmp_path):
    path = tmp_path / "ball.png"
    Image.fromarray(plain_ball()).save(path)
    view, reasons, lines = room(LAYOUT, caplog, path)
    assert (view.fov, view.pitch) == (50, 15)
    assert "a usual lens" in reasons["fov"] and "at a table" in reasons["pitch"]
    assert len(lines) == 2


def test_objects_that_hide_the_lines_are_left_out(tmp_path):
    """Strokes on a thing agree with nothing; the room beside it tells the camera."""
    view = view_of(18.0, 52.0)
    rgb = drawn_room.draw(view, -15.0)
    mask = np.zeros(rgb.shape[:2], bool)
    mask[150:350, 120:360] = True
    rgb[mask] = strokes(count=120)[: view.height, : view.width][mask]
    Image.fromarray(rgb).save(tmp_path / "photo.png")
    photo = photograph.read(tmp_path / "photo.png")
    assert fit_frame(detect_segments(rgb), view.height, view.fov) is None
    frame = camera_guess._vanishing_frame(photo, [mask], view.fov, None)
    assert np.degrees(frame.pitch) == pytest.approx(18, abs=1.5)


def test_the_scene_has_this_camera_and_a_second_start_keeps_it(tmp_path, capfd):
    view = view_of(22.0, 55.0)
    photo, layout = tmp_path / "photo.png", tmp_path / "layout.toml"
    Image.fromarray(drawn_room.draw(view, 20.0)).save(photo)
    text = LAYOUT.replace("[0, 0, 9, 9]", str(box_around(view, 20.0, 2)))
    layout.write_text(text.replace("20 cm", "50 cm"))
    out = tmp_path / "out"
    assert main([str(photo), str(layout), "-o", str(out)]) == 0
    lines = [line for line in capfd.readouterr().out.splitlines() if line.startswith("camera: pi")]
    assert len(lines) == 1 and "vanishing lines" in lines[0]
    text = layout.read_text()
    camera = tomllib.loads(text)["camera"]
    assert camera["pitch"] == pytest.approx(22, abs=1.5)
    assert camera["fov"] == pytest.approx(55, rel=0.1)
    assert camera["height"] == pytest.approx(1.2, rel=0.1), "of the eye"
    assert "degrees, guessed: vanishing lines" in text
    drawn = tomllib.loads((out / "render.toml").read_text())["camera"]
    assert drawn["fov"] == pytest.approx(camera["fov"])
    changed = text.replace(f"pitch = {camera['pitch']}", "pitch = 20.0")
    layout.write_text(changed)
    assert main([str(photo), str(layout), "-o", str(out)]) == 0
    assert not any("vanishing" in line for line in capfd.readouterr().out.splitlines())
    assert layout.read_text() == changed


def box_around(view, yaw, number):
    """The box in the picture around a box of the room."""
    low, high = np.array(drawn_room.BOXES[number][:2])
    corners = np.array(np.meshgrid(*zip(low, high))).reshape(3, -1).T - (0, 0, 1.2)
    pixels, _ = view.pixels(corners @ drawn_room.turn(yaw).T)
    left, top = np.floor(pixels.min(axis=0) - 4).astype(int)
    right, bottom = np.ceil(pixels.max(axis=0) + 4).astype(int)
    return [max(int(left), 0), max(int(top), 0), min(int(right), 479), min(int(bottom), 359)]
