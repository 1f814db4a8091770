"""The live page and what a viewer may send: other messages change nothing and end nothing."""

import logging
import threading
from urllib.parse import urlsplit

import pytest

from tests.support import drawn_runs
from tests.support.launch import until
from tests.support.live_pages import LivePageProcess, Viewer

viser = pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[live]"')
import msgspec  # noqa: E402

from vgmpi.postprocess.frames import render_config  # noqa: E402
from vgmpi.postprocess.live import guarded_server  # noqa: E402
from vgmpi.postprocess.live.followed_run import FollowedRun  # noqa: E402
from vgmpi.postprocess.live.live_page import LivePage, PageOptions  # noqa: E402

CONTROLS = ("frame", "following", "playing", "rate", "color", "plot", "stop", "save", "draw")
WRONG_VALUES = (
    None, "no choice", "", "true", -1, 1 << 40, -(1 << 60), 1.5e300, float("nan"), float("inf"),
    0.5, [], [1], {}, {"a": 1}, b"x",
)  # fmt: skip
CHANGED = {"color": "velocity", "playing": True, "rate": 20.0}


class Page:
    """A page in this process, whose controls a test can read."""

    def __init__(self, folder):
        sock = guarded_server.open_socket("127.0.0.1", 0)
        port = sock.getsockname()[1]
        rules = guarded_server.AccessRules(None, port)
        self.server = guarded_server.start_server("127.0.0.1", rules, sock, "")
        chosen = render_config.load(None)
        followed = FollowedRun(folder, 1000, chosen.look)
        options = PageOptions(None, folder / "render.toml", None)
        self.page = LivePage(self.server, followed, chosen, options)
        self.thread = threading.Thread(target=self.page.run)
        self.thread.start()
        self.viewer = Viewer(f"ws://127.0.0.1:{port}/")
        until(lambda: "velocity" in self.page.panel.color.options, "a frame")

    def send(self, message):
        """Send a message as a browser does."""
        self.viewer.link.send(
            message if isinstance(message, (bytes, str)) else msgspec.msgpack.encode(message)
        )

    def change(self, name, updates):
        """Send a change of a control."""
        uuid = getattr(self.page.panel, name)._impl.uuid
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})

    def values(self):
        """The values of all controls, with their types, and what they offer."""
        controls = (getattr(self.page.panel, name) for name in CONTROLS)
        return [(type(c.value), c.value, getattr(c, "options", None)) for c in controls]

    def close(self):
        """End the page."""
        self.page.end()
        self.thread.join()
        self.viewer.close()
        guarded_server.stop_server(self.server)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    opened = Page(drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=3))
    yield opened
    opened.close()


def settle(page):
    """Wait until all that was sent before has been read and the loop has gone round."""
    rate = 11.0 if page.page.panel.rate.value != 11.0 else 12.0
    page.change("rate", {"value": rate})
    until(lambda: page.page.panel.rate.value == rate, "the last message")
    page.page._wake.set()
    until(lambda: not page.page._wake.is_set() or not page.thread.is_alive(), "the loop")
    assert page.thread.is_alive(), "a message has ended the page"
    page.page.panel.rate.value = 10.0


@pytest.mark.parametrize("name", CONTROLS)
def test_no_value_that_a_control_has_not_changes_it(page, name, capfd):
    settle(page)
    before = page.values()
    for value in WRONG_VALUES:
        page.change(name, {"value": value})
    for key in ("options", "max", "update_cb", "removed", "uuid", "is_button", "none"):
        page.change(name, {key: "x"})
    settle(page)
    assert page.values() == before
    assert "Traceback" not in "".join(capfd.readouterr())


def test_a_value_that_a_control_has_changes_it(page):
    page.page.panel.following.value = False
    for name, value in CHANGED.items():
        old = getattr(page.page.panel, name).value
        page.change(name, {"value": value})
        until(lambda n=name, v=value: getattr(page.page.panel, n).value == v, name)
        page.change(name, {"value": old})
        until(lambda n=name, v=old: getattr(page.page.panel, n).value == v, name)
    settle(page)


CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [3.0, 0.0, 1.0],
    "fov": 0.7, "near": 0.01, "far": 1000.0, "image_height": 700, "image_width": 900,
    "look_at": [0.5, 0.5, 0.5], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


def test_a_camera_is_of_finite_numbers(page):
    """A view is saved and drawn with it, and the colors of a frame are seen from it."""
    client = next(iter(page.server.get_clients().values()))
    page.send(CAMERA | {"position": [4.0, 0.0, 1.0]})
    until(lambda: client.camera.position[0] == 4.0, "the camera")
    for key in CAMERA.keys() - {"type"}:
        for value in ("x", None, [], [1.0], ["x"] * 3, [float("nan")] * 4, float("nan"), {}, 1e300):
            page.send(CAMERA | {key: value})
        page.send({name: value for name, value in CAMERA.items() if name != key})
    page.send(CAMERA | {"more": 1})
    page.page._shown = None  # the frame is sent again, seen from the camera
    settle(page)
    assert list(client.camera.position) == [4.0, 0.0, 1.0] and client.camera.fov == 0.7


def test_bytes_that_are_no_message_leave_the_viewer_connected(page, capfd):
    nested = b"\x91" * 3000 + b"\xc0"
    for raw in (b"", b"\xc1", b"\x80", b"\x01", b"\xa1x", nested, b"\xdd\xff\xff\xff\xff", "text"):
        page.send(raw)
    for kind in ("ShareUrlRequest", "FileTransferStartUpload", "Message", "none", None, [], {}):
        page.send({"type": kind})
    settle(page)
    assert "Traceback" not in "".join(capfd.readouterr())


def test_a_reason_is_logged_once(caplog):
    messages = guarded_server.MessageFilter()
    with caplog.at_level(logging.WARNING):
        assert not any(messages.passes(b"\x01") for _ in range(5))
        assert messages.passes(msgspec.msgpack.encode(CAMERA))
    assert len(caplog.records) == 1


def test_a_fault_of_the_loop_is_one_line_and_the_page_goes_on(page, monkeypatch, caplog):
    """Whatever a control or a file leads to, the page stays for its other viewers."""
    calls = []

    def fail():
        calls.append(True)
        raise ZeroDivisionError("of a test\nsecond line")

    with caplog.at_level(logging.WARNING):
        monkeypatch.setattr(page.page, "_show_plot", fail)
        until(lambda: len(calls) >= 2, "two faults")
        monkeypatch.undo()
    told = [r.getMessage() for r in caplog.records if "of a test" in r.getMessage()]
    assert len(told) == 1 and "\n" not in told[0] and "ZeroDivisionError" in told[0]
    settle(page)


def test_a_page_of_its_own_process_survives_the_word_of_a_viewer(tmp_path):
    """As the command does it: the page goes on, and its end is a right one."""
    out = drawn_runs.write(tmp_path / "out", frames=1)
    with LivePageProcess(out, "--port", 0) as live:
        viewer = Viewer(f"ws://127.0.0.1:{urlsplit(live.address).port}/")
        viewer.wait_for(1000, 0.0)
        for message in (CAMERA | {"position": ["x", 0, 0]}, {"type": "GuiUpdateMessage"}):
            viewer.link.send(msgspec.msgpack.encode(message))
        again = Viewer(f"ws://127.0.0.1:{urlsplit(live.address).port}/")
        again.wait_for(1000, 0.0)
        viewer.close()
        again.close()
        assert live.process.poll() is None
        live.process.terminate()
        code, _, err = live.wait()
    assert code == 130 and "Traceback" not in err and err.count("\n") == 2, err
