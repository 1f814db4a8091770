"""Server of the page on which the masks of a layout are edited, for this machine alone."""

import base64
import json
import logging
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pydantic import ValidationError

from vgmpi.postprocess.live.guarded_server import AccessRules, open_socket

from ..grabcut import MaskError
from ..layout_config import LayoutError
from .edit_session import EditedLayout, EditedObject, EditSession, png

log = logging.getLogger("vgmpi.tools.photo")

PAGE = Path(__file__).with_name("editor_page.html")
HOST = "127.0.0.1"
MAX_REQUEST = 20_000_000  # [bytes] of a request
WRONG_TOKEN = "wrong or missing token: open the address that vgmpi photo --edit has printed"
COLORS = ((230, 25, 75), (60, 180, 75), (0, 130, 200), (245, 130, 48), (145, 30, 180),
          (70, 240, 240), (240, 50, 230), (210, 245, 60), (250, 190, 212))  # fmt: skip


class EditServer(ThreadingHTTPServer):
    """Server of one editing session.

    Args:
        session: The layout that is edited.
        port: Port; 0: any that is free.
        token: Word that the address has to hold.

    Raises:
        RunError: The port is taken.
    """

    daemon_threads = True

    def __init__(self, session: EditSession, port: int, token: str):
        super().__init__((HOST, port), PageHandler, bind_and_activate=False)
        self.socket.close()
        self.socket = open_socket(HOST, port)
        self.rules = AccessRules(token, self.socket.getsockname()[1])
        self.session = session
        self.was_saved = False

    @property
    def address(self) -> str:
        """Return the address for a browser."""
        return f"http://{HOST}:{self.rules.port}/?token={self.rules.token}"

    def handle_error(self, *_: Any) -> None:
        """Log a fault of one request in one line: it ends the page for nobody."""
        error = sys.exception()
        if not isinstance(error, OSError):  # a browser that has gone says nothing to anybody
            log.warning("the page goes on after a fault: %s", type(error).__name__)

    def end(self) -> None:
        """Let serve_forever() return."""
        threading.Thread(target=self.shutdown, daemon=True).start()


class _Headers:
    """Headers of a request in the form that AccessRules reads."""

    def __init__(self, message: Any):
        self._message = message

    def get_all(self, name: str) -> list[str]:
        """Return all values of a header."""
        return self._message.get_all(name, [])


class PageHandler(BaseHTTPRequestHandler):
    """Answers of the server: the page, the photograph, masks and saving."""

    server: EditServer
    protocol_version = "HTTP/1.1"
    timeout = 60

    def log_message(self, *_: Any) -> None:
        """Log nothing; the terminal shows what is saved."""

    def do_GET(self) -> None:
        """Answer to a request for the page or the photograph."""
        if not self._is_allowed():
            return
        path = self._path()
        if path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", PAGE.read_bytes())
        elif path == "/photo.png":
            self._send(HTTPStatus.OK, "image/png", png(self.server.session.photo.rgb))
        elif path == "/state":
            session = self.server.session
            objects = [item.model_dump() for item in session.objects]
            self._send_json({"objects": objects, "layout": str(session.path), "colors": COLORS})
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not found\n")

    def do_POST(self) -> None:
        """Answer to a request for a mask, or to save."""
        if not self._is_allowed():
            return
        path = self._path()
        action = {"/mask": self._mask, "/save": self._save, "/end": self._end}.get(path)
        if action is None:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not found\n")
            return
        try:
            size = int(self.headers.get("Content-Length", ""))
        except ValueError:
            size = -1
        if not 0 <= size <= MAX_REQUEST:
            self.close_connection = True
            self._send_error(f"a request has 0 to {MAX_REQUEST} bytes")
            return
        try:
            self._send_json(action(self.rfile.read(size)))
        except ValidationError as error:
            detail = error.errors()[0]
            place = ".".join(str(part) for part in detail["loc"])
            self._send_error(f"{place}: {detail['msg']}")
        except LayoutError as error:
            self._send_error("; ".join(error.lines))
        except MaskError as error:
            self._send_error(str(error))
        except OSError as error:
            self._send_error(f"{error.filename}: {error.strerror or error}")

    def _path(self) -> str:
        """Return the path of the request, "" for an address that is none."""
        try:
            return urlsplit(self.path).path
        except ValueError:
            return ""

    def _mask(self, body: bytes) -> dict[str, Any]:
        """Return the mask of an object as a picture, and what is doubtful about it."""
        edited = EditedObject.model_validate_json(body)
        mask, box = self.server.session.mask(edited)
        levels = png(mask.astype("uint8") * 255)
        return {
            "mask": base64.b64encode(levels).decode(),
            "pixels": int(mask.sum()),
            "box": box,
            "warnings": self.server.session.warnings(edited, mask),
        }

    def _save(self, body: bytes) -> dict[str, Any]:
        """Save the layout; return a line about it."""
        written = self.server.session.save(EditedLayout.model_validate_json(body))
        names = " and ".join(str(path) for path in written)
        log.info("saved %s", names)
        self.server.was_saved = True
        return {"message": f"saved {names}"}

    def _end(self, _body: bytes) -> dict[str, Any]:
        """End the server."""
        self.server.end()
        return {"message": "the page has ended: go back to the terminal"}

    def _is_allowed(self) -> bool:
        """Return whether a request passes the rules; answer it if it does not."""
        rules, headers = self.server.rules, _Headers(self.headers)
        if reason := rules.refusal(headers):
            self._send(HTTPStatus.FORBIDDEN, "text/plain", f"{reason}\n".encode())
            return False
        if rules.has_cookie(headers):
            return True
        word = rules.token_of_path(self.path)
        if word is None or not rules.is_token(word):
            self._send(HTTPStatus.FORBIDDEN, "text/plain", f"{WRONG_TOKEN}\n".encode())
            return False
        cookie = f"{rules.cookie}={word}; HttpOnly; SameSite=Strict; Path=/"
        self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", Location="/", Set_Cookie=cookie)
        return False

    def _send_json(self, values: dict[str, Any]) -> None:
        """Send values as JSON."""
        self._send(HTTPStatus.OK, "application/json", json.dumps(values).encode())

    def _send_error(self, message: str) -> None:
        """Send one line about a mistake."""
        body = json.dumps({"error": " ".join(message.split())}).encode()
        self._send(HTTPStatus.BAD_REQUEST, "application/json", body)

    def _send(self, status: HTTPStatus, kind: str, body: bytes, **headers: str) -> None:
        """Send an answer."""
        if status == HTTPStatus.FORBIDDEN:
            self.close_connection = True  # the body of the request is not read
        self.send_response(status)
        fields = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
        }
        for name, value in (fields | headers).items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)
