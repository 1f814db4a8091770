"""A live page as a process of its own, a browser on it, and a run for it to follow."""

import re
import threading
import time

import pytest

from tests.support.headless_browser import new_page
from tests.support.launch import PATIENCE
from tests.support.page_process import PageProcess

SCENE = """
title = "A ball falls into water"
[domain]
size = ["12 cm", "8 cm", "8 cm"]
cell = "1 cm"
[time]
end = "4 s"
frames = 401
[output]
checkpoint_interval = 0
[material.rubber]
kind = "elastic"
density = 1000
youngs_modulus = "0.1 MPa"
[material.water]
kind = "fluid"
density = 1000
[[object]]
name = "ball"
material = "rubber"
shape = { sphere = { center = ["4 cm", "4 cm", "6 cm"], radius = "2 cm" } }
color = "#e02020"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], ["12 cm", "8 cm", "3 cm"]] }
color = "#2040e0"
[[probe]]
name = "ball"
object = "ball"
sampling_rate = 500
"""


ROW_BYTES = 32  # of a Gaussian on its way to a browser


class LivePageProcess(PageProcess):
    """`vgmpi live` as a process."""

    def __init__(self, *words):
        pytest.importorskip("viser", reason='needs viser: pip install "vgmpi[live]"')
        super().__init__("live", *words)


def opened(browser, address, errors):
    """A page of a browser with the status of the run on it."""
    page = new_page(browser, 900, 700)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.get_by_text(re.compile("of [\\d,]+ Gaussians")).wait_for()
    page.get_by_text("Software WebGL").wait_for()  # it would hide a part of the scene
    page.locator(".mantine-Notification-closeButton").first.click()
    return page


class Viewer:
    """A client that reads all that the page sends, and tells it of a camera as a browser does."""

    def __init__(self, address: str):
        import msgspec
        import viser
        from viser._messages import ViewerCameraMessage
        from websockets.sync.client import connect

        protocol = [f"viser-v{viser.__version__}"]
        self.link = connect(address, subprotocols=protocol, max_size=None)  # type: ignore[arg-type]
        camera = ViewerCameraMessage(
            (1.0, 0.0, 0.0, 0.0), (3.0, 0.0, 1.0), 0.7, 0.01, 1000.0, 700, 900, (0.5, 0.5, 0.5),
            (0.0, 0.0, 1.0),
        )  # fmt: skip
        self.link.send(msgspec.msgpack.encode(camera.as_serializable_dict()))
        self.arrivals: list[tuple[float, int]] = []  # time [s], bytes
        self.thread = threading.Thread(target=self._listen, daemon=True)
        self.thread.start()

    def _listen(self) -> None:
        from websockets.exceptions import ConnectionClosed

        try:
            while True:
                data = self.link.recv()
                self.arrivals.append((time.time(), len(data)))
        except (ConnectionClosed, OSError):
            pass

    def wait_for(self, size: int, since: float) -> float:
        """Return when a message of at least `size` bytes came after `since`."""
        end = time.time() + PATIENCE
        while time.time() < end:
            for when, count in list(self.arrivals):
                if count >= size and when >= since:
                    return when
            time.sleep(0.002)
        raise RuntimeError(f"no frame within {PATIENCE} s")

    def close(self) -> None:
        """Leave."""
        self.link.close()
        self.thread.join()
