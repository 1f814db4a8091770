"""vgmpi photo --edit: clicks and painted masks in a browser, and the same masks without it."""

import http.client
import json
import signal
import socket
import struct
import sys
import tomllib
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from tests.support import drawn_photograph
from tests.support.headless_browser import browser_of, new_page
from tests.support.launch import run
from tests.support.mask_editor_pages import EditorProcess, Hand
from vgmpi.tools.photo import grabcut, layout_config, learned_models, object_masks, photograph
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.layout_config import LayoutError
from vgmpi.tools.photo.mask_editor.edit_session import (
    EditedLayout,
    EditedObject,
    EditSession,
    Stroke,
)

pytest.importorskip("cv2", reason="no OpenCV: pip install 'vgmpi[images]'")
pytest.importorskip("tomlkit", reason="no tomlkit: pip install 'vgmpi[images]'")


@pytest.fixture
def photo(tmp_path):
    path = tmp_path / "photo.png"
    Image.fromarray(drawn_photograph.three().rgb).save(path)
    return path


def masks_of(layout, photo):
    """The masks that `vgmpi photo` finds for a layout, by the names of its objects."""
    loaded, read = layout_config.read(layout), photograph.read(photo)
    masks = object_masks.segment_objects(loaded, read, learned_models.load(loaded).finder)
    return {obj.name: one.mask for obj, one in zip(loaded.layout.object, masks)}


def middle(mask):
    rows, columns = np.nonzero(mask)
    return int(columns.mean()), int(rows.mean())


def shown(session, key):
    """The mask of an object as the page shows it at the start."""
    return session.mask(next(item for item in session.objects if item.key == key))[0]


@pytest.mark.browser
def test_click_paint_undo_save_and_the_same_masks_without_the_page(photo, tmp_path):
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    ball, cup, box = drawn_photograph.three().masks
    errors = []
    with (
        EditorProcess(photo, "-o", tmp_path / "out") as editor,
        api.sync_playwright() as play,
    ):
        page = new_page(browser_of(play), 1100, 700)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(editor.address)
        hand = Hand(page)
        left, top, right, bottom = drawn_photograph.bounding_box(ball)
        hand.drag((left, top), (right, bottom))  # object 1: a box
        hand.press("n")
        hand.drag(middle(cup))  # object 2: a click
        assert grabcut.iou(shown_mask(page, 1), cup) > 0.9
        hand.press("b")
        hand.drag((5, 5))  # a click on the background, taken back
        assert hand.objects()[1]["points"][-1] == [5.5, 5.5, False]
        hand.press("z")
        assert len(hand.objects()[1]["points"]) == 1
        hand.press("n", "p")
        x, y = middle(box)
        hand.drag((x - 30, y), (x + 30, y))  # object 3: painted
        painted = shown_mask(page, 2)
        assert painted[y, x] and painted[y, x - 30] and not painted[y + 40, x]
        hand.press("e")
        hand.drag((x, y - 30), (x, y + 30))
        assert not shown_mask(page, 2)[y, x]
        hand.press("z")
        assert (shown_mask(page, 2) == painted).all()
        hand.press("y", "z", "1")
        hand.name(1, "ball")
        hand.name(2, "cup", "10 cm")
        hand.name(3, "box")
        seen = {name: shown_mask(page, k) for k, name in enumerate(("ball", "cup", "box"))}
        hand.save()
        page.get_by_role("button", name="end").click()
        code, out, err = editor.wait()
    assert (code, errors, err) == (0, [], "") and "layout.toml: saved" in out, out
    layout = tmp_path / "out" / "layout.toml"
    tables = tomllib.loads(layout.read_text())["object"]
    assert [sorted(table) for table in tables] == [
        ["box", "name"], ["box", "height", "name", "point_prompts"], ["mask", "name"],
    ]  # fmt: skip
    assert (tmp_path / "out" / tables[2]["mask"]).is_file()
    masks = masks_of(layout, photo)
    assert {name: bool((masks[name] == seen[name]).all()) for name in seen} == dict.fromkeys(
        seen, True
    )
    assert grabcut.iou(masks["ball"], ball) > 0.95 and grabcut.iou(masks["cup"], cup) > 0.9


def shown_mask(page, number):
    """The mask of an object on the page, (height, width) bool."""
    text = """(number) => {
        const image = editor.masks.get(editor.state.objects[number].key).image;
        const pane = new OffscreenCanvas(image.width, image.height), pen = pane.getContext("2d");
        pen.drawImage(image, 0, 0);
        const pixels = pen.getImageData(0, 0, image.width, image.height).data, bits = [];
        for (let i = 0; i < pixels.length; i += 4) bits.push(pixels[i] > 127 ? 1 : 0);
        return [image.height, image.width, bits.join("")];
    }"""
    height, width, bits = page.evaluate(text, number)
    return (np.frombuffer(bits.encode(), np.uint8) == ord("1")).reshape(height, width)


def request(address, path, body=None, cookie=None, **headers):
    """Status, headers and body of the answer to a request."""
    link = http.client.HTTPConnection("127.0.0.1", urlsplit(address).port)
    fields = {name.replace("_", "-"): value for name, value in headers.items()}
    fields |= {} if cookie is None else {"Cookie": cookie}
    link.request("GET" if body is None else "POST", path, body, fields)
    answer = link.getresponse()
    text = answer.read()
    link.close()
    return answer.status, dict(answer.getheaders()), text


def test_the_page_needs_its_token(photo, tmp_path):
    with EditorProcess(photo, "-o", tmp_path / "out") as editor:
        parts = urlsplit(editor.address)
        assert parts.hostname == "127.0.0.1" and len(parts.query) > 30
        for path in ("/", "/photo.png", "/state", "/?token=wrong"):
            status, _, text = request(editor.address, path)
            assert status == 403 and b"wrong or missing token" in text
        status, headers, _ = request(editor.address, f"/?{parts.query}")
        cookie = headers["Set-Cookie"].split(";")[0]
        assert status == 303 and headers["Location"] == "/"
        assert request(editor.address, "/", cookie=cookie)[0] == 200
        assert request(editor.address, "/../setup.sh", cookie=cookie)[0] == 404
        assert request(editor.address, "/none", b"{}", cookie)[0] == 404
        assert request(editor.address, "/save", b"{}", cookie, Origin="https://a.org")[0] == 403
        wrong_bodies = [
            (b"{", "Invalid JSON"),
            (b"{}", "key: Field required"),
            (json.dumps({"key": "a", "name": "a", "strokes": [
                {"radius": 0, "erases": False, "path": [[1, 1]]}]}).encode(), "strokes.0.radius"),
        ]  # fmt: skip
        for body, says in wrong_bodies:
            status, _, text = request(editor.address, "/mask", body, cookie)
            assert status == 400 and says in json.loads(text)["error"], text
        status, _, text = request(editor.address, "/save", b'{"objects": []}', cookie)
        assert status == 400 and "there is no object" in json.loads(text)["error"]
        status, _, text = request(editor.address, "/save", b"", cookie, Content_Length="-5")
        assert status == 400 and b"a request has 0 to" in text
    assert not (tmp_path / "out").exists()


def test_requests_that_are_none_end_no_page_and_print_no_traceback(photo, tmp_path):
    """They come before any token is asked for."""
    with EditorProcess(photo, "-o", tmp_path / "out") as editor:
        port = urlsplit(editor.address).port
        for request_bytes in (
            b"GET / HTTP/1.1\r\nHost: [\r\n\r\n",
            b"GET //[ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
            b"GET /?token=%ff&%zz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
            b"GET /?token=\xed\xa0\x80 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
            b"GET /?" + b"a=1&" * 2000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
            b"POST /save HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        ):
            with socket.create_connection(("127.0.0.1", port)) as link:
                link.sendall(request_bytes)
                assert link.recv(100).split()[1] in (b"400", b"403"), request_bytes[:30]
        gone = socket.create_connection(("127.0.0.1", port))
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        gone.sendall(b"GET / HTTP/1.1\r\n")
        gone.close()  # with a reset
        assert request(editor.address, "/")[0] == 403
        editor.process.send_signal(signal.SIGINT)
        code, _, err = editor.wait()
    assert (code, err) == (0, "")


BOX = (60, 150, 220, 330)
LAYOUT = """# mine
[camera]
pitch = 18  # measured

[[object]]
name = "ball"  # the red one
box = {box}
height = "10 cm"

[[object]]
name = "nothing"
box = [0, 0, 50, 50]

[scene]
end = "0.3 s"
"""


def session_of(photo, text=None):
    layout = photo.with_name("layout.toml")
    if text is not None:
        layout.write_text(text)
    return EditSession(photograph.read(photo), layout)


def test_what_was_not_edited_stays_as_it_was_written(photo):
    ball = drawn_photograph.three().masks[0]
    text = LAYOUT.format(box=drawn_photograph.bounding_box(ball))
    session = session_of(photo, text)
    first, second = session.objects
    session.save(EditedLayout(objects=(first,)))
    saved = session.path.read_text()
    start, stop = text.index('[[object]]\nname = "nothing'), text.index("[scene]")
    assert saved == text[:start] + text[stop:]
    x, y = middle(ball)
    stroke = Stroke(radius=6.0, erases=True, path=((float(x), float(y)),))
    session.save(EditedLayout(objects=(first.model_copy(update={"strokes": (stroke,)}),)))
    mask = masks_of(session.path, photo)["ball"]
    assert mask.any() and not mask[y, x]
    assert "# the red one" in session.path.read_text() and "# measured" in session.path.read_text()
    # a stroke that is taken back after it was saved
    session.save(EditedLayout(objects=(first,)))
    assert (masks_of(session.path, photo)["ball"] == shown(session, first.key)).all()


def test_strokes_on_a_mask_from_a_file_can_be_taken_back(photo):
    ball = drawn_photograph.three().masks[0]
    Image.fromarray(ball).save(photo.with_name("mine.png"))
    session = session_of(photo, '[[object]]\nname = "ball"\nmask = "mine.png"\nheight = 0.1\n')
    (item,) = session.objects
    assert (session.mask(item)[0] == ball).all() and item.height == "0.1 m"
    stroke = Stroke(radius=8.0, erases=False, path=((20.0, 20.0), (60.0, 20.0)))
    session.save(EditedLayout(objects=(item.model_copy(update={"strokes": (stroke,)}),)))
    mask = masks_of(session.path, photo)["ball"]
    assert mask[20, 40] and mask[20, 20] and not mask[40, 40]
    session.save(EditedLayout(objects=(item,)))
    assert (masks_of(session.path, photo)["ball"] == ball).all()
    assert (np.asarray(Image.open(photo.with_name("mine.png"))) == ball).all()


@pytest.mark.parametrize(
    "changes, says",
    [
        ({"name": "1"}, "name: must begin with a letter"),
        ({"height": "9 kg"}, "height: "),
        ({"box": None}, "its mask is empty"),
    ],
)
def test_an_object_that_cannot_be_saved_is_named(photo, changes, says):
    session = session_of(photo)
    item = EditedObject(key="a", name="ball", box=BOX).model_copy(update=changes)
    with pytest.raises(LayoutError) as error:
        session.save(EditedLayout(objects=(item,)))
    assert len(error.value.lines) == 1 and f"'{item.name}': {says}" in error.value.lines[0]
    assert not session.path.exists()


def test_two_objects_of_one_name_are_refused(photo):
    session = session_of(photo)
    pair = tuple(EditedObject(key=key, name=key.upper(), box=BOX) for key in ("a", "b"))
    same = tuple(item.model_copy(update={"name": "Ball"[:4]}) for item in pair)
    with pytest.raises(LayoutError, match="two objects have the name 'ball'"):
        session.save(EditedLayout(objects=same))


def test_points_of_a_large_photograph_are_pixels_of_the_file(tmp_path):
    """The page shows the photograph reduced; the layout speaks of the file."""
    path = tmp_path / "photo.png"
    rgb = Image.fromarray(drawn_photograph.three().rgb)
    rgb.resize((2070, 1553)).save(path)
    session = session_of(path)
    ball = drawn_photograph.three().masks[0]
    box = tuple(2 * v for v in drawn_photograph.bounding_box(ball))
    x, y = middle(ball)
    item = EditedObject(
        key="a", name="ball", box=box, points=((2 * x + 0.5, 2 * y + 0.5, True), (3.5, 7.5, False))
    )
    session.save(EditedLayout(objects=(item,)))
    (table,) = tomllib.loads(session.path.read_text())["object"]
    assert table["box"] == [round(v * 2070 / 1280) for v in box]
    assert table["point_prompts"][0][0] == pytest.approx((2 * x + 0.5) * 2070 / 1280, abs=0.06)
    assert (masks_of(session.path, path)["ball"] == session.mask(item)[0]).all()


@pytest.mark.parametrize(
    "words, says",
    [
        (["--edit", "--find"], "--edit: not allowed with --find"),
        (["--port", "8000"], "--port: allowed with --edit only"),
        (["--edit", "--port", "70000"], "--port: 70000: allowed: 0 to 65535"),
    ],
)
def test_wrong_flags_are_one_line(photo, tmp_path, words, says, capfd):
    assert main([str(photo), "-o", str(tmp_path / "out"), *words]) == 2
    text = capfd.readouterr().err.strip()
    assert says in text and "\n" not in text


def test_a_port_that_is_taken_is_one_line(photo, tmp_path, capfd):
    with EditorProcess(photo, "-o", tmp_path / "out") as editor:
        port = str(urlsplit(editor.address).port)
        assert main([str(photo), "-o", str(tmp_path / "out"), "--edit", "--port", port]) == 2
    text = capfd.readouterr().err.strip()
    assert port in text and "in use" in text and "\n" not in text


def test_a_broken_layout_is_one_line(photo, tmp_path, capfd):
    layout = tmp_path / "layout.toml"
    layout.write_text('[[object]]\nname = "a"\nbox = 3\n')
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out"), "--edit"]) == 2
    text = capfd.readouterr().err.strip()
    assert text.startswith(f"{layout}:3: object.a.box") and "\n" not in text
    layout.write_text('[[object]]\nname = "a"\nmask = "none.png"\n')
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out"), "--edit"]) == 2
    assert "none.png" in capfd.readouterr().err


def test_a_wheel_has_the_page():
    """Packaging is told of the file by its pattern."""
    from tests.support.launch import ROOT

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    patterns = settings["package-data"]["vgmpi"]
    pages = {path for pattern in patterns for path in (ROOT / "vgmpi").glob(pattern)}
    assert ROOT / "vgmpi" / "tools" / "photo" / "mask_editor" / "editor_page.html" in pages


def test_help_names_the_page():
    assert "--edit" in run([sys.executable, "-m", "vgmpi", "photo", "--help"]).stdout
